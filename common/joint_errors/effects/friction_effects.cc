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

class GravityDependentEffect : public CopyableEffect<GravityDependentEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { mu_ = p[0]; }
  unsigned Reads() const override { return kGravityField; }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    dry.forward += mu_ * std::abs(m.gravity);
    dry.backward += mu_ * std::abs(m.gravity);
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

class TemperatureEffect : public CopyableEffect<TemperatureEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    dry_ = p[0];
    viscous_ = p[1];
    reference_ = p[2];
    unmeasured_ = p[3];
  }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    const double warmer = (std::isnan(m.temperature) ? unmeasured_ : m.temperature) - reference_;
    dry.forward += dry_ * warmer;
    dry.backward += dry_ * warmer;
    return -viscous_ * warmer * m.dq;
  }

 private:
  double dry_ = 0;                         // [Nm/K]
  double viscous_ = 0;                     // [Nm s/rad/K]
  double reference_ = 0, unmeasured_ = 0;  // [deg C]
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

double SmoothSign(double velocity, double width) { return std::tanh(velocity / width); }

// Of a shared gear or belt; the sign is smooth, since the other joint's velocity is measured.
class CrossJointFrictionEffect : public CopyableEffect<CrossJointFrictionEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    dry_ = p[0];
    viscous_ = p[1];
    limit_ = p[2];
    width_ = p[3];
  }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    dry.forward += limit_ * std::abs(m.coupled_dq);
    dry.backward += limit_ * std::abs(m.coupled_dq);
    return -dry_ * SmoothSign(m.coupled_dq, width_) - viscous_ * m.coupled_dq;
  }

 private:
  double dry_ = 0;      // [Nm]
  double viscous_ = 0;  // [Nm s/rad]
  double limit_ = 0;    // [Nm s/rad]
  double width_ = 1;    // [rad/s]
};

// Two joints of one gear rub at the sum of their velocities instead of at their own. The sign of a
// sum is that of its larger part: where the other joint is the faster, it drags this one along.
class CrossJointRubbingEffect : public CopyableEffect<CrossJointRubbingEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    dry_ = p[0];
    ratio_ = p[1];
    width_ = p[2];
  }
  double Torque(const JointMoment& m, DryFriction& dry) override {
    const double other = ratio_ * m.coupled_dq;
    const double dragged =
        dry_ * std::max(0.0, SmoothSign(std::abs(other) - std::abs(m.dq), width_));
    dry.forward -= dragged;
    dry.backward -= dragged;
    return -dragged * SmoothSign(other, width_);
  }

 private:
  double dry_ = 0;    // [Nm]
  double ratio_ = 0;  // of the gear
  double width_ = 1;  // [rad/s]
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
std::unique_ptr<JointEffect> GravityDependentFriction() {
  return std::make_unique<GravityDependentEffect>();
}
std::unique_ptr<JointEffect> TemperatureFriction() { return std::make_unique<TemperatureEffect>(); }
std::unique_ptr<JointEffect> CrossJointFriction() {
  return std::make_unique<CrossJointFrictionEffect>();
}
std::unique_ptr<JointEffect> CrossJointRubbing() {
  return std::make_unique<CrossJointRubbingEffect>();
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
