#pragma once

#include <Eigen/Core>

#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "common/method_options.h"
#include "common/types.h"

namespace robostress {

// Self-compensation with a fixed point, beside the paper's: the disturbance is what the arm did
// beyond a nominal arm that got the commands as they were sent, referred to the command,
//
//   w_i = (dx_i - dx_nominal(c)_i) / g
//   d  <- clip(d + k (w_i - d), -d_max, d_max)      per executed step
//   c   = a - KeptShare(|d|, d_min) d               for the next chunk, each axis
//
// symbol  name                shape  unit
// a       policy command      [6]    normalised action
// c       sent command        [6]    normalised action, with whatever else changed it
// d       estimate            [6]    normalised action
// g       tracking_gain       -      achieved / commanded displacement of a nominal arm
// k       integral_rate       -      per control step
// d_max   integral_limit      -      normalised action
// d_min   integral_threshold  -      normalised action; 0: c = a - d
//
// Where dx = g c + g d_0, d goes to d_0 and the arm does g a; an arm that answers as the nominal
// one leaves d at 0, so Clean is a fixed point for every command. Under a lower gain g' it goes to
// the command a g / g' as far as d_max allows. End-effector space; the gripper is left alone.
class IntegralAction {
 public:
  using Vector6 = NominalArm::Vector6;
  static constexpr int kStateSize = 18;

  IntegralAction(const MethodOptions& method, const ResidualOptions& residual,
                 const NominalArmOptions& arm);

  // The arm is at rest; the estimate is forgotten unless integral_carry.
  void StartEpisode();
  // Masked steps move the nominal arm and not the estimate.
  void Observe(const ExecutedChunk& chunk);
  const Vector6& estimate() const { return estimate_; }
  // What is added to a policy's commands.
  Vector6 correction() const;

  // Estimate, nominal goal, nominal velocity: all that it remembers.
  Eigen::VectorXd State() const;
  void SetState(const Eigen::VectorXd& state);
  // Whether Observe can have left it: an estimate within its limit, an arm that holds.
  bool Holds(const Eigen::VectorXd& state) const;

 private:
  double rate_, limit_, threshold_, gain_;
  int axes_;  // the first so many
  bool carry_;
  ResidualOptions residual_;  // scale command: dx in normalised actions
  NominalArm arm_;
  Vector6 estimate_ = Vector6::Zero();
};

}  // namespace robostress
