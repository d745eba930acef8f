#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/statusor.h"
#include "nlohmann/json.hpp"

namespace robostress {

// What identifies a row of a unit's episodes.jsonl: everything that is known before the episode
// runs.
struct EpisodeIdentity {
  std::string suite, scenario, policy, method;  // scenario: its label
  int severity = 0;
  int64_t seed = 0;
  int task = 0;
  int episode = 0;        // within the task
  int initial_state = 0;  // first_initial_state + episode
  bool operator==(const EpisodeIdentity&) const = default;

  template <class Self, class V>
  static void Visit(Self& r, V& v) {
    v.Field("suite", r.suite);
    v.Field("scenario", r.scenario);
    v.Field("severity", r.severity);
    v.Field("policy", r.policy);
    v.Field("method", r.method);
    v.Field("seed", r.seed);
    v.Field("task", r.task);
    v.Field("episode", r.episode);
    v.Field("initial_state", r.initial_state);
  }
};

// One row: outcome and residual sums of a finished episode (adapter/episode_metrics.h says what
// they are). Measures that an episode does not have (no unadapted prediction, no motion) are
// absent. Nothing in it depends on the clock.
struct EpisodeRow {
  int task = 0, episode = 0, initial_state = 0;  // read; what is written is the identity's
  bool success = false;
  int steps = 0, chunks = 0;
  int updates = 0;  // applied in this unit so far
  std::optional<double> adapter_distance;
  std::optional<double> residual;                            // ||eta|| / ||a||, paper
  std::optional<double> eta_sq, a_sq;                        // its squared sums
  std::optional<double> residual_tracking, tracking_eta_sq;  // with the controller's steady gain
  std::optional<double> intent;                              // ||dx - a_base|| / ||a_base||
  std::optional<double> intent_tracking;
  std::optional<double> intent_eta_sq, intent_tracking_eta_sq, intent_a_sq;
  std::optional<double> mean_abs_action, clipped_share;
  std::optional<double> lag_residual, lag_eta_sq;  // same commands, no joint errors (worker --lag)
  // Of units with latency or latency.smoothness (common/rollout/motion_smoothness.h).
  std::optional<double> jerk;  // [m/s^3]
  std::optional<double> jump;  // [command units]
  // Of robots of robot_client, whose residual is in joint space: eta_sq / a_sq over the steps that
  // feedback held, without those masked.
  std::optional<double> seconds;                         // in RUN [s]
  std::optional<uint64_t> measured_steps, masked_steps;  // of those in feedback
  std::optional<int> power_cycles;                       // of the arm so far
  std::optional<std::string> state, cause, instruction;  // of the client at the end; words
  std::string record;  // the line as it was read, for episodes.csv

  template <class Self, class V>
  static void Visit(Self& r, V& v) {
    v.Field("task", r.task);
    v.Field("episode", r.episode);
    v.Field("initial_state", r.initial_state);
    v.Field("success", r.success);
    v.Field("steps", r.steps);
    v.Field("chunks", r.chunks);
    v.Field("updates", r.updates);
    v.Measure("adapter_distance", r.adapter_distance);
    v.Measure("residual", r.residual);
    v.Measure("eta_sq", r.eta_sq);
    v.Measure("a_sq", r.a_sq);
    v.Measure("residual_tracking", r.residual_tracking);
    v.Measure("tracking_eta_sq", r.tracking_eta_sq);
    v.Measure("intent", r.intent);
    v.Measure("intent_tracking", r.intent_tracking);
    v.Measure("intent_eta_sq", r.intent_eta_sq);
    v.Measure("intent_tracking_eta_sq", r.intent_tracking_eta_sq);
    v.Measure("intent_a_sq", r.intent_a_sq);
    v.Measure("mean_abs_action", r.mean_abs_action);
    v.Measure("clipped_share", r.clipped_share);
    v.Extra("lag_residual", r.lag_residual);
    v.Extra("lag_eta_sq", r.lag_eta_sq);
    v.Extra("jerk", r.jerk);
    v.Extra("jump", r.jump);
    v.Extra("seconds", r.seconds);
    v.Extra("measured_steps", r.measured_steps);
    v.Extra("masked_steps", r.masked_steps);
    v.Extra("power_cycles", r.power_cycles);
    v.Extra("state", r.state);
    v.Extra("cause", r.cause);
    v.Extra("instruction", r.instruction);
  }
};

// One line of timing.jsonl [s]: kept apart because it never repeats.
struct TimingRow {
  int task = 0, episode = 0;
  std::optional<double> wall_s, predict_s, step_s, observe_s, feedback_s;

  template <class Self, class V>
  static void Visit(Self& r, V& v) {
    v.Field("task", r.task);
    v.Field("episode", r.episode);
    v.Measure("wall_s", r.wall_s);
    v.Measure("predict_s", r.predict_s);
    v.Measure("step_s", r.step_s);
    v.Measure("observe_s", r.observe_s);
    v.Measure("feedback_s", r.feedback_s);
  }
};

// One line of episodes.jsonl: sorted keys, numbers as the shortest text that reads back equal.
std::string EpisodeLine(const EpisodeIdentity& identity, const EpisodeRow& row);
// Reads one. Errors (DATA_LOSS) name file, line, field and value.
absl::StatusOr<EpisodeRow> ParseEpisode(const std::string& source, const std::string& line);
// True where the line is a row of that episode.
bool IsRowOf(const EpisodeIdentity& identity, const std::string& line);

std::string TimingLine(const TimingRow& row);
// Absent where the line is no timing of an episode.
std::optional<TimingRow> ParseTiming(const std::string& line);

}  // namespace robostress
