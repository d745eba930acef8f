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

enum class IntegralAxes { kAll, kTranslation };

struct IntegralOptions {
  using Corrector = class IntegralAction;
  static constexpr MethodWay kWay{
      .name = "integral_action", .key = "integral_rate", .in_joint_space = false};

  double rate = 0;       // k, per control step; 0: off
  double limit = 0.2;    // bound of the estimate on each axis [command units]
  double threshold = 0;  // smaller estimates correct nothing [command units]
  IntegralAxes axes = IntegralAxes::kAll;
  bool carry = false;  // the estimate outlives its episode

  // Chosen on the dev split (docs/results/integral-action.md).
  static IntegralOptions Tuned(double threshold = 0) {
    return {.rate = 0.01,
            .limit = 0.5,
            .threshold = threshold,
            .axes = IntegralAxes::kTranslation,
            .carry = true};
  }

  bool on() const { return rate != 0; }
  bool carries_over() const { return carry; }
  absl::Status Check() const;

  template <class V>
  void Visit(V& v) {
    v.Field("integral_rate", rate,
            "integral action: share of the newest disturbance in the estimate, per control step; "
            "0: none");
    v.Field("integral_limit", limit,
            "bound of the estimated disturbance on each axis [command units]");
    v.Field("integral_threshold", threshold,
            "estimates below it correct nothing, larger ones d by d - threshold^2 / d "
            "[command units]");
    v.Choice("integral_axes", axes,
             {{"all", IntegralAxes::kAll}, {"translation", IntegralAxes::kTranslation}},
             "axes whose disturbance is estimated and subtracted");
    v.Field("integral_carry", carry, "keep the estimate across episodes");
  }
};

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
class IntegralAction : public Corrector {
 public:
  using Vector6 = NominalArm::Vector6;
  static constexpr int kStateSize = 18;

  IntegralAction(const IntegralOptions& options, const ResidualOptions& residual,
                 const NominalArmOptions& arm);

  std::unique_ptr<Corrector> Clone() const override {
    return std::make_unique<IntegralAction>(*this);
  }
  // The arm is at rest; the estimate is forgotten unless integral_carry.
  void StartEpisode() override;
  // Masked steps move the nominal arm and not the estimate.
  void Observe(const ExecutedChunk& chunk) override;
  void Forget(double kept) override { estimate_ *= kept; }
  bool LearnsSlowly() const override { return true; }
  const Vector6& estimate() const { return estimate_; }
  Eigen::VectorXd correction() const override;  // [6]

  // Estimate, nominal goal, nominal velocity.
  Eigen::VectorXd State() const override;
  void SetState(const Eigen::VectorXd& state) override;
  // An estimate within its limit, an arm that holds.
  bool Holds(const Eigen::VectorXd& state) const override;

 private:
  IntegralOptions options_;
  int axes_;                  // the first so many
  ResidualOptions residual_;  // scale command: dx in normalised actions
  NominalArm arm_;
  Vector6 estimate_ = Vector6::Zero();
};

}  // namespace robostress
