#include <algorithm>
#include <cmath>

#include "common/joint_errors/effects/effect_makers.h"

namespace robostress::effects {
namespace {

class TorqueSaturationEffect : public CopyableEffect<TorqueSaturationEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { limit_ = p[0]; }
  double Drive(double torque, const JointMoment&) override {
    return std::clamp(torque, -limit_, limit_);
  }
  // Beyond the limit the torque says nothing of what was asked: that is scaled by how far the
  // torque is from the limit, so that a limit of nearly 0 explains no more than another one.
  double Asked(double torque, double asked, const JointMoment&) override {
    return std::abs(asked) > limit_ ? std::abs(asked) * torque / limit_ : torque;
  }

 private:
  double limit_ = 0;  // [Nm]
};

// Torques below the width do nothing, larger ones lose it.
class DeadzoneEffect : public CopyableEffect<DeadzoneEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { width_ = p[0]; }
  double Drive(double torque, const JointMoment&) override {
    return std::copysign(std::max(0.0, std::abs(torque) - width_), torque);
  }
  // Smooth through 0, which every torque within the zone gives.
  double Asked(double torque, double, const JointMoment&) override {
    return width_ > 0 ? torque + width_ * torque / (std::abs(torque) + kSmooth * width_) : torque;
  }

 private:
  static constexpr double kSmooth = 0.05;
  double width_ = 0;  // [Nm]
};

class TimeVaryingGainEffect : public CopyableEffect<TimeVaryingGainEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { rate_ = p[0]; }
  double Drive(double torque, const JointMoment& m) override { return torque * GainAt(m.t); }
  double Asked(double torque, double, const JointMoment& m) override {
    return torque / std::max(GainAt(m.t), kLeastGain);
  }

 private:
  static constexpr double kLeastGain = 0.05;
  double GainAt(double t) const { return 1 + rate_ * t; }
  double rate_ = 0;  // [1/s]
};

class MotorGainEffect : public CopyableEffect<MotorGainEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { gain_ = 1 + p[0]; }
  double Drive(double torque, const JointMoment&) override { return torque * gain_; }
  double Asked(double torque, double, const JointMoment&) override { return torque / gain_; }

 private:
  double gain_ = 1;  // above 0 within its bounds
};

}  // namespace

std::unique_ptr<JointEffect> TorqueSaturation() {
  return std::make_unique<TorqueSaturationEffect>();
}
std::unique_ptr<JointEffect> Deadzone() { return std::make_unique<DeadzoneEffect>(); }
std::unique_ptr<JointEffect> MotorGain() { return std::make_unique<MotorGainEffect>(); }
std::unique_ptr<JointEffect> TimeVaryingGain() { return std::make_unique<TimeVaryingGainEffect>(); }

}  // namespace robostress::effects
