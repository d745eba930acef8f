#include <algorithm>
#include <cmath>

#include "common/joint_errors/effects/effect_makers.h"
#include "common/joint_errors/effects/friction.h"

namespace robostress::effects {
namespace {

// The law of friction.h. Under `stick` its dry part bounds stiction and its viscous part is a
// torque; under the others all of it is a torque.
class StribeckEffect : public CopyableEffect<StribeckEffect> {
 public:
  StribeckEffect(FrictionLaw law, double tanh_width) : form_(law), tanh_width_(tanh_width) {}
  void SetParameters(absl::Span<const double> p) override {
    law_.Fc = p[0];
    law_.Fs = std::max(p[0], p[1]);
    law_.vs = p[2];
    law_.sigma_v = p[3];
  }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    if (form_ != FrictionLaw::kStick) return StribeckTorque(law_, m.dq, form_, tanh_width_);
    const double magnitude = StribeckMagnitude(law_, m.dq);
    dry.forward += magnitude;
    dry.backward += magnitude;
    return -law_.sigma_v * m.dq;
  }

 private:
  FrictionLaw form_;
  double tanh_width_;  // [rad/s]
  JointErrorParameters law_;
};

class AsymmetricCoulombEffect : public CopyableEffect<AsymmetricCoulombEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { difference_ = p[0]; }
  double Torque(const JointMoment&, DryFriction& dry) override {
    dry.forward += difference_;
    dry.backward -= difference_;
    return 0;
  }

 private:
  double difference_ = 0;  // [Nm]
};

class AsymmetricViscousEffect : public CopyableEffect<AsymmetricViscousEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { difference_ = p[0]; }
  double Torque(const JointMoment& m, DryFriction&) override {
    return -difference_ * std::abs(m.dq);
  }

 private:
  double difference_ = 0;  // [Nm s/rad]
};

class LoadDependentEffect : public CopyableEffect<LoadDependentEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { mu_ = p[0]; }
  unsigned Reads() const override { return kDriveField; }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    dry.forward += mu_ * std::abs(m.drive);
    dry.backward += mu_ * std::abs(m.drive);
    return 0;
  }

 private:
  double mu_ = 0;
};

class QuadraticViscousEffect : public CopyableEffect<QuadraticViscousEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { c2_ = p[0]; }
  double Torque(const JointMoment& m, DryFriction&) override {
    return -c2_ * m.dq * std::abs(m.dq);
  }

 private:
  double c2_ = 0;  // [Nm s^2/rad^2]
};

class TimeDriftEffect : public CopyableEffect<TimeDriftEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { rate_ = p[0]; }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    dry.forward += rate_ * m.t;
    dry.backward += rate_ * m.t;
    return 0;
  }

 private:
  double rate_ = 0;  // [Nm/s]
};

// Dahl: dz/dx = (1 - sgn(dx) z) / x_s, integrated exactly over the way of a sub-step; -F z.
class PreslidingEffect : public CopyableEffect<PreslidingEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    F_ = p[0];
    x_s_ = p[1];
  }
  void Reset(const JointMoment&) override { z_ = 0; }
  bool HasState() const override { return true; }
  double Torque(const JointMoment& m, DryFriction&) override {
    const double way = m.dq * m.h, end = way > 0 ? 1 : -1;
    if (way != 0) z_ = end + (z_ - end) * std::exp(-std::abs(way) / x_s_);
    return -F_ * z_;
  }

 private:
  double F_ = 0;    // [Nm]
  double x_s_ = 1;  // [rad]
  double z_ = 0;    // in [-1, 1]
};

class PositionDependentEffect : public CopyableEffect<PositionDependentEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    a_ = p[0];
    b_ = p[1];
    wave_ = 2 * M_PI / p[2];
  }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    const double change = a_ * std::cos(wave_ * m.q) + b_ * std::sin(wave_ * m.q);
    dry.forward += change;
    dry.backward += change;
    return 0;
  }

 private:
  double a_ = 0, b_ = 0;  // [Nm]
  double wave_ = 1;       // [rad/rad]
};

}  // namespace

std::unique_ptr<JointEffect> StribeckFrictionOf(FrictionLaw law, double tanh_width) {
  return std::make_unique<StribeckEffect>(law, tanh_width);
}
std::unique_ptr<JointEffect> StribeckFriction() {
  return StribeckFrictionOf(FrictionLaw::kStick, 0);
}
std::unique_ptr<JointEffect> AsymmetricCoulomb() {
  return std::make_unique<AsymmetricCoulombEffect>();
}
std::unique_ptr<JointEffect> AsymmetricViscous() {
  return std::make_unique<AsymmetricViscousEffect>();
}
std::unique_ptr<JointEffect> LoadDependentFriction() {
  return std::make_unique<LoadDependentEffect>();
}
std::unique_ptr<JointEffect> QuadraticViscousFriction() {
  return std::make_unique<QuadraticViscousEffect>();
}
std::unique_ptr<JointEffect> TimeDriftFriction() { return std::make_unique<TimeDriftEffect>(); }
std::unique_ptr<JointEffect> PreslidingHysteresis() { return std::make_unique<PreslidingEffect>(); }
std::unique_ptr<JointEffect> PositionDependentFriction() {
  return std::make_unique<PositionDependentEffect>();
}

}  // namespace robostress::effects
