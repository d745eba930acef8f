#pragma once

#include <Eigen/Core>
#include <memory>

#include "absl/status/status.h"
#include "adapter/corrector.h"
#include "adapter/method_way.h"
#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "common/types.h"

namespace robostress {

// A control: what a lab tries first on a delta controller.
struct LeakyGoalOptions {
  using Corrector = class LeakyGoal;
  static constexpr MethodWay kWay{
      .name = "leaky_goal", .key = "goal_memory", .in_joint_space = false};

  double memory = 0;   // rho; 0: off, 1: goals are never forgotten
  double limit = 0.5;  // bound of the correction on each axis [command units]

  bool on() const { return memory != 0; }
  bool carries_over() const { return false; }
  absl::Status Check() const;

  template <class V>
  void Visit(V& v) {
    v.Late("goal_memory", memory, 0.0,
           "leaky goal: share of the way to the last goal that is added to the next command; 0: "
           "none");
    v.Late("goal_limit", limit, 0.5, "bound of what it adds on each axis [command units]");
  }
};

// A goal that was not reached stays in part:
//
//   c_k = a_k + clip(rho (goal_(k-1) - x_k)),   goal_(k-1) - x_k = c_(k-1) - dx_(k-1)
//
// symbol  name         shape  unit
// a, c    command      [6]    normalised action, of the policy, and as it was sent
// dx      motion       [6]    normalised action, of the newest unmasked step
// rho     goal_memory  -
//
// A nominal arm does not reach its goal within a step either, so Clean is not a fixed point: a
// constant command moves the arm by g / (1 - rho (1 - g)) of it instead of g. End-effector space;
// the gripper is left alone.
class LeakyGoal : public Corrector {
 public:
  using Vector6 = NominalArm::Vector6;

  LeakyGoal(const LeakyGoalOptions& options, const ResidualOptions& residual,
            const NominalArmOptions&);

  std::unique_ptr<Corrector> Clone() const override { return std::make_unique<LeakyGoal>(*this); }
  void StartEpisode() override { left_.setZero(); }
  void Observe(const ExecutedChunk& chunk) override;
  Eigen::VectorXd correction() const override;  // [6]

  // The way to the last goal.
  Eigen::VectorXd State() const override { return left_; }
  void SetState(const Eigen::VectorXd& state) override;
  bool Holds(const Eigen::VectorXd& state) const override;

 private:
  static constexpr double kFarthest = 1e12;  // plausible motion stays below
  LeakyGoalOptions options_;
  ResidualOptions residual_;  // scale command: dx in normalised actions
  Vector6 left_ = Vector6::Zero();
};

}  // namespace robostress
