#pragma once

#include <optional>
#include <string>

namespace robostress {

// One line of a unit's servers.jsonl, where somebody else serves the policy: who answers from this
// episode on, and how often the connection broke during it. A worker writes one before its first
// episode, and one after each episode that changed something. Kept apart from episodes.jsonl: a
// connection that breaks never repeats.
struct ServerRow {
  int task = 0, episode = 0;
  std::string url;  // without its query, which may hold a key
  std::string metadata_sha256;
  int reconnections = 0;                // during that episode
  std::optional<std::string> metadata;  // JSON, where it changed while the worker ran

  template <class Self, class V>
  static void Visit(Self& r, V& v) {
    v.Field("task", r.task);
    v.Field("episode", r.episode);
    v.Field("url", r.url);
    v.Field("metadata_sha256", r.metadata_sha256);
    v.Field("reconnections", r.reconnections);
    v.Extra("metadata", r.metadata);
  }
};

}  // namespace robostress
