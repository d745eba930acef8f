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

 private:
  double width_ = 0;  // [Nm]
};

class TimeVaryingGainEffect : public CopyableEffect<TimeVaryingGainEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { rate_ = p[0]; }
  double Drive(double torque, const JointMoment& m) override { return torque * (1 + rate_ * m.t); }

 private:
  double rate_ = 0;  // [1/s]
};

}  // namespace

std::unique_ptr<JointEffect> TorqueSaturation() {
  return std::make_unique<TorqueSaturationEffect>();
}
std::unique_ptr<JointEffect> Deadzone() { return std::make_unique<DeadzoneEffect>(); }
std::unique_ptr<JointEffect> TimeVaryingGain() { return std::make_unique<TimeVaryingGainEffect>(); }

}  // namespace robostress::effects
