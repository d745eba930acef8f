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

  static constexpr double kShare = 0.2;  // of the presets that have it

  double share = 0;  // 0: off
  double way = 4;    // [command units]; 0.2 m with LIBERO's scale

  bool on() const { return share != 0; }
  bool carries_over() const { return false; }
  absl::Status Check() const;

  template <class V>
  void Visit(V& v) {
    v.Late("envelope_share", share, 0.0,
           "an arm that makes less than this share of a nominal arm's way is held by something: "
           "integral action learns nothing, and soon all corrections go back to zero; 0: not "
           "watched");
    v.Late("envelope_way", way, 4.0,
           "way of the nominal arm, within about 40 control steps, after which they do [command "
           "units]");
  }
};

// Adds nothing. Tells motion that joint errors do not explain from motion that they do:
//
//   n <- (1 - 1 / T) n + dx_nominal(c),   x <- (1 - 1 / T) x + dx       per executed step
//   held where |n| > w and n.x < s |n|^2
//
// symbol        name                        shape  unit
// c             sent command                [6]    normalised action
// dx            motion                      [3]    normalised action
// n, x          recent way                  [3]    normalised action, of the nominal and of the arm
// T             kShort, kLong               -      control steps
// w             kShortWay; way (with kLong)        normalised action
// s             share                       -
//
// An arm that is held for long is no arm with a joint that sticks: more was pushed than moves such
// a one. CommandCorrection then shows all ways masked steps and takes kForgotten of what they
// remember at every one. From the short memory on, it shows them to those that learn slowly: what
// integral action learned of an obstacle would push for five seconds after it.
class Envelope : public Corrector {
 public:
  static constexpr double kShort = 10, kShortWay = 0.5, kLong = 40, kForgotten = 0.2;

  Envelope(const EnvelopeOptions& options, const ResidualOptions& residual,
           const NominalArmOptions& arm);

  std::unique_ptr<Corrector> Clone() const override { return std::make_unique<Envelope>(*this); }
  void StartEpisode() override;
  void Observe(const ExecutedChunk& chunk) override;
  Eigen::VectorXd correction() const override { return {}; }

  bool held() const { return Held(long_, options_.way); }
  bool held_shortly() const { return Held(short_, kShortWay); }

  // n, x of both memories, goal and velocity of the nominal arm.
  Eigen::VectorXd State() const override;
  void SetState(const Eigen::VectorXd& state) override;
  bool Holds(const Eigen::VectorXd& state) const override;

 private:
  struct Way {
    Eigen::Vector3d nominal = Eigen::Vector3d::Zero(), moved = Eigen::Vector3d::Zero();
  };
  bool Held(const Way& recent, double way) const;

  static constexpr int kStateSize = 6 + 6 + 12;
  static constexpr double kFarthest = 1e12;  // plausible motion stays below
  EnvelopeOptions options_;
  ResidualOptions residual_;  // scale command: dx in normalised actions
  NominalArm arm_;
  Way short_, long_;
};

}  // namespace robostress
