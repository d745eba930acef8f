#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "absl/status/statusor.h"

namespace robostress {

// One line of an arm's episodes.jsonl, as robot_client writes it. What is not known is left out.
struct ArmEpisode {
  std::optional<int> task;
  int episode = 0;
  std::optional<bool> success;  // null: nobody said
  double seconds = 0;
  std::optional<uint64_t> predictions, failed_predictions;
  std::optional<uint64_t> failed_feedback;  // chunks that the server refused
  uint64_t feedback_chunks = 0;
  uint64_t steps = 0, steps_masked = 0;           // of those in feedback: measured, left out
  double residual = 0;                            // sqrt(eta_sq / displacement_sq), joint space
  std::optional<double> eta_sq, displacement_sq;  // [rad^2]
  uint64_t adapter_version = 0;                   // updates applied
  std::optional<uint64_t> sessions;
  std::string state;                 // of the client when it ended
  std::optional<std::string> cause;  // of that state

  template <class Self, class V>
  static void Visit(Self& r, V& v) {
    v.Extra("task", r.task);
    v.Field("episode", r.episode);
    v.Measure("success", r.success);
    v.Field("seconds", r.seconds);
    v.Extra("predictions", r.predictions);
    v.Extra("failed_predictions", r.failed_predictions);
    v.Extra("failed_feedback", r.failed_feedback);
    v.Field("feedback_chunks", r.feedback_chunks);
    v.Field("steps", r.steps);
    v.Field("steps_masked", r.steps_masked);
    v.Field("residual", r.residual);
    v.Extra("eta_sq", r.eta_sq);
    v.Extra("displacement_sq", r.displacement_sq);
    v.Field("adapter_version", r.adapter_version);
    v.Extra("sessions", r.sessions);
    v.Field("state", r.state);
    v.Extra("cause", r.cause);
  }
};

std::string ArmEpisodeLine(const ArmEpisode& row);
// Errors (DATA_LOSS) name `source`, field and value.
absl::StatusOr<ArmEpisode> ParseArmEpisode(const std::string& source, const std::string& line);

}  // namespace robostress
