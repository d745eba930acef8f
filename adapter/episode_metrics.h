#pragma once

#include <cstdint>
#include <optional>

#include "adapter/residual.h"
#include "common/types.h"

namespace robostress {

// Residual sums of one episode (paper, sec:residual-magnitude), over executed steps and without the
// gripper. They do not depend on a method's residual_scale, so methods can be compared:
//
//   residual           = sqrt(sum ||dx - a||^2        / sum ||a||^2)         (paper)
//   residual_tracking  = sqrt(sum ||dx/g - a||^2      / sum ||a||^2)
//   intent             = sqrt(sum ||dx - a_base||^2   / sum ||a_base||^2)
//   intent_tracking    = sqrt(sum ||dx/g - a_base||^2 / sum ||a_base||^2)
//
// dx: displacement / c; g: tracking_gain; a_base: the unadapted policy's command.
// a is the policy's command before a correction (direct, gain), clipped to +-1 where the options
// say so.
class EpisodeMetrics {
 public:
  explicit EpisodeMetrics(const ResidualOptions& options);

  // Adds every step of a chunk; chunks of one episode in any order.
  void Add(const ExecutedChunk& chunk);

  int64_t steps() const { return steps_; }
  double eta_sq() const { return eta_sq_; }
  double a_sq() const { return a_sq_; }
  double residual() const;
  double residual_tracking() const;
  double tracking_eta_sq() const { return tracking_eta_sq_; }
  // Absent when a step came without the unadapted policy's command.
  std::optional<double> intent() const;
  std::optional<double> intent_tracking() const;
  double intent_eta_sq() const { return intent_eta_sq_; }
  double intent_tracking_eta_sq() const { return intent_tracking_eta_sq_; }
  double intent_a_sq() const { return intent_a_sq_; }
  // Mean |a| over steps and entries, unclipped.
  double mean_abs_action() const;
  // Share of the sent entries that the controller clipped, |entry| > 1.
  double clipped_share() const;

 private:
  ResidualOptions command_, tracking_;
  int64_t steps_ = 0, entries_ = 0, clipped_ = 0;
  bool has_intent_ = true;
  double eta_sq_ = 0, a_sq_ = 0, tracking_eta_sq_ = 0;
  double intent_eta_sq_ = 0, intent_tracking_eta_sq_ = 0, intent_a_sq_ = 0;
  double abs_sum_ = 0;
};

}  // namespace robostress
