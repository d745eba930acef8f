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

// What a held arm must not do: build up corrections that it makes up for when it is let go.
struct EnvelopeOptions {
  using Corrector = class Envelope;
  static constexpr MethodWay kWay{
      .name = "envelope", .key = "envelope_share", .in_joint_space = false};

  double share = 0;  // 0: off
  double way = 0.5;  // [command units]; 25 mm with LIBERO's scale

  bool on() const { return share != 0; }
  bool carries_over() const { return false; }
  absl::Status Check() const;

  template <class V>
  void Visit(V& v) {
    v.Late("envelope_share", share, 0.0,
           "an arm that makes less than this share of a nominal arm's way is held by something: "
           "corrections learn nothing and go back to zero; 0: not watched");
    v.Late("envelope_way", way, 0.5,
           "shortest way of the nominal arm from which that is told [command units]");
  }
};

// Adds nothing. Tells motion that joint errors do not explain from motion that they do:
//
//   n <- (1 - 1 / T) n + dx_nominal(c),   x <- (1 - 1 / T) x + dx       per executed step
//   held where |n| > w and n.x < s |n|^2
//
// symbol        name            shape  unit
// c             sent command    [6]    normalised action
// dx            motion          [3]    normalised action
// n, x          recent way      [3]    normalised action, of the nominal and of the real arm
// T             kMemory         -      control steps
// w, s          way, share      -
//
// While an arm is held, CommandCorrection shows the other ways masked steps and takes kForgotten of
// what they remember at every one.
class Envelope : public Corrector {
 public:
  static constexpr double kMemory = 10, kForgotten = 0.2;

  Envelope(const EnvelopeOptions& options, const ResidualOptions& residual,
           const NominalArmOptions& arm);

  std::unique_ptr<Corrector> Clone() const override { return std::make_unique<Envelope>(*this); }
  void StartEpisode() override;
  void Observe(const ExecutedChunk& chunk) override;
  Eigen::VectorXd correction() const override { return {}; }

  bool held() const;

  // n, x, goal and velocity of the nominal arm.
  Eigen::VectorXd State() const override;
  void SetState(const Eigen::VectorXd& state) override;
  bool Holds(const Eigen::VectorXd& state) const override;

 private:
  static constexpr int kStateSize = 3 + 3 + 12;
  static constexpr double kFarthest = 1e12;  // plausible motion stays below
  EnvelopeOptions options_;
  ResidualOptions residual_;  // scale command: dx in normalised actions
  NominalArm arm_;
  Eigen::Vector3d nominal_ = Eigen::Vector3d::Zero(), moved_ = Eigen::Vector3d::Zero();
};

}  // namespace robostress
