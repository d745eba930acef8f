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

enum class FollowingAxes { kTranslation, kHorizontal };

struct FollowingOptions {
  using Corrector = class ModelFollowing;
  static constexpr MethodWay kWay{
      .name = "model_following", .key = "following_gain", .in_joint_space = false};

  double gain = 0;       // K, command per shortfall; 0: off
  double memory = 20;    // T, control steps that a shortfall counts
  double threshold = 0;  // a smaller shortfall corrects nothing [command units]
  double limit = 0.5;    // bound of the correction on each axis [command units]
  FollowingAxes axes = FollowingAxes::kTranslation;

  // Chosen on the dev split (docs/results/model-following-search.md). The threshold lies above what
  // the nominal arm is wrong by in Clean: 9 of 10 shortfalls there are below 0.2 to 0.3.
  static FollowingOptions Tuned() {
    return {.gain = 1, .memory = 10, .threshold = 0.2, .axes = FollowingAxes::kHorizontal};
  }
  // Of integral action beside it: 95 of 100 estimates in Clean are below 0.06.
  static constexpr double kIntegralThreshold = 0.04;

  bool on() const { return gain != 0; }
  bool carries_over() const { return false; }
  absl::Status Check() const;

  template <class V>
  void Visit(V& v) {
    v.Field("following_gain", gain,
            "model following: command per distance that the arm is behind a nominal one "
            "[command units]; 0: none");
    v.Field("following_memory", memory,
            "control steps after which a distance fallen behind is forgotten to 1/e");
    v.Field("following_threshold", threshold,
            "a distance below it corrects nothing, a larger one e by e - threshold^2 / e "
            "[command units]");
    v.Field("following_limit", limit, "bound of its correction on each axis [command units]");
    v.Choice(
        "following_axes", axes,
        {{"translation", FollowingAxes::kTranslation}, {"horizontal", FollowingAxes::kHorizontal}},
        "axes that follow; horizontal: x and y of the base frame");
  }
};

// Self-compensation with a reference, beside the paper's: the arm is led after a nominal one that
// does what the policy asked for,
//
//   e_i = (1 - 1 / T) e_(i-1) + dx_nominal(a)_i - dx_i     per executed step
//   c   = a + clip(K KeptShare(|e|, e_min) e, c_max)       for the next chunk
//
// symbol  name                 shape  unit
// a       policy command       [6]    normalised action, before any correction; for the nominal arm
//                                     the unadapted policy's, where it is known
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
class ModelFollowing : public Corrector {
 public:
  using Vector6 = NominalArm::Vector6;
  static constexpr int kStateSize = 15;
  // What plausible motion adds up to in the longest memory, with the smallest translation_scale.
  static constexpr double kMaxShortfall = 1e15;

  ModelFollowing(const FollowingOptions& options, const ResidualOptions& residual,
                 const NominalArmOptions& arm);

  std::unique_ptr<Corrector> Clone() const override {
    return std::make_unique<ModelFollowing>(*this);
  }
  // The arm is at rest and behind nothing.
  void StartEpisode() override;
  // Masked steps move the nominal arm and forget; they add nothing.
  void Observe(const ExecutedChunk& chunk) override;
  void Forget(double kept) override { shortfall_ *= kept; }
  Eigen::VectorXd correction() const override;  // [6]

  // Shortfall, nominal goal, nominal velocity.
  Eigen::VectorXd State() const override;
  void SetState(const Eigen::VectorXd& state) override;
  // A shortfall up to kMaxShortfall, an arm that holds.
  bool Holds(const Eigen::VectorXd& state) const override;

 private:
  FollowingOptions options_;
  int axes_;                  // the first so many
  ResidualOptions residual_;  // scale command: dx in normalised actions
  NominalArm arm_;
  Eigen::Vector3d shortfall_ = Eigen::Vector3d::Zero();
};

}  // namespace robostress
