#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "absl/status/status.h"
#include "adapter/command_correction.h"
#include "adapter/disturbance_observer.h"
#include "server/proxy/arm_motion.h"
#include "server/proxy/arm_profile.h"

namespace robostress {

// What a method adds to the commands of one arm, in its own numbers and before any limit: the
// correctors of adapter/, or of joints the disturbance observer. One thread.
class ArmCorrection {
 public:
  ArmCorrection(const ArmProfile& profile, const MethodOptions& method);

  void StartEpisode();
  // `dt_s`: since the motion before it. INVALID_ARGUMENT, and nothing changes: a chunk that nobody
  // can have measured.
  absl::Status Observe(const ArmMotion& motion, double dt_s);
  // [columns]
  Eigen::VectorXd Value() const;

 private:
  Eigen::Index columns_;
  ResidualOptions residual_;
  CommandCorrection correction_;
  // Of eight joints each; none: the method has none.
  std::vector<DisturbanceObserver> observers_;
};

// Holds a correction to its limits: |x| and, from one control step to the next, |change of x|.
class CorrectionLimiter {
 public:
  explicit CorrectionLimiter(const ArmProfile& profile)
      : limit_(profile.correction_limit()), step_(profile.step_limit()) {
    Reset();
  }

  // The arm moves, or will move, as the policy says.
  void Reset() { applied_ = Eigen::VectorXd::Zero(limit_.size()); }
  // [columns] of the step that was executed last.
  const Eigen::VectorXd& applied() const { return applied_; }
  void Executed(const Eigen::VectorXd& correction) { applied_ = correction; }
  // What `wanted` comes to in the step after one with `now`.
  Eigen::VectorXd Next(const Eigen::VectorXd& now, const Eigen::VectorXd& wanted) const;

 private:
  const Eigen::VectorXd limit_, step_;
  Eigen::VectorXd applied_;
};

}  // namespace robostress
