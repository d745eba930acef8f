#pragma once

#include <Eigen/Core>

#include "adapter/nominal_arm.h"
#include "adapter/residual.h"
#include "common/method_options.h"
#include "common/types.h"

namespace robostress {

// Self-compensation with a reference, beside the paper's: the arm is led after a nominal one that
// does what the policy asked for,
//
//   e_i = (1 - 1 / T) e_(i-1) + dx_nominal(a)_i - dx_i     per executed step
//   c   = a + clip(K KeptShare(|e|, e_min) e, c_max)       for the next chunk
//
// symbol  name                 shape  unit
// a       policy command       [6]    normalised action, before any correction
// c       sent command         [6]    normalised action
// e       shortfall            [3]    normalised action: how far the arm is behind
// |e|                          -      over the axes that follow
// K       following_gain       -      command per shortfall
// T       following_memory     -      control steps
// e_min   following_threshold  -      normalised action
// c_max   following_limit      -      normalised action, each axis
//
// It is the reference, not the disturbance, that is compared: lost motion that comes back by itself
// comes back in e too. The policy looks again, so an old shortfall is its own affair: hence T. A
// steady disturbance d is taken off but for 1 / (1 + K g T) of it, g the nominal arm's steady gain,
// as far as e_min lets it. An arm that answers as the nominal one leaves e at 0; what the nominal
// arm is wrong by in Clean is what e_min is for. End-effector space; x, y and z or x and y of the
// base frame (following_axes); rotations and the gripper are left alone.
class ModelFollowing {
 public:
  using Vector6 = NominalArm::Vector6;
  static constexpr int kStateSize = 15;
  // What plausible motion adds up to in the longest memory, with the smallest translation_scale.
  static constexpr double kMaxShortfall = 1e15;

  ModelFollowing(const MethodOptions& method, const ResidualOptions& residual,
                 const NominalArmOptions& arm);

  // The arm is at rest and behind nothing.
  void StartEpisode();
  // Masked steps move the nominal arm and forget; they add nothing.
  void Observe(const ExecutedChunk& chunk);
  // What is added to a policy's commands.
  Vector6 correction() const;

  // Shortfall, nominal goal, nominal velocity: all that it remembers.
  Eigen::VectorXd State() const;
  void SetState(const Eigen::VectorXd& state);
  // Whether Observe can have left it: a shortfall up to kMaxShortfall, an arm that holds.
  bool Holds(const Eigen::VectorXd& state) const;

 private:
  double gain_, keep_, threshold_, limit_;
  int axes_;                  // the first so many
  ResidualOptions residual_;  // scale command: dx in normalised actions
  NominalArm arm_;
  Eigen::Vector3d shortfall_ = Eigen::Vector3d::Zero();
};

}  // namespace robostress
