#include <cmath>

#include "common/joint_errors/effects/effect_makers.h"
#include "common/joint_errors/effects/gravity_residual.h"

namespace robostress::effects {
namespace {

class GravityErrorEffect : public CopyableEffect<GravityErrorEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { law_.beta = p[0]; }
  unsigned Reads() const override { return kGravityField; }
  double Torque(const JointMoment& m, DryFriction&) override {
    return GravityResidual(law_, m.gravity, GravitySign::kLiteral);
  }

 private:
  JointErrorParameters law_;
};

class PayloadEffect : public CopyableEffect<PayloadEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { mass_ = p[0]; }
  unsigned Reads() const override { return kPayloadFields; }
  double Torque(const JointMoment& m, DryFriction&) override { return -mass_ * m.payload_gravity; }
  double Inertia(const JointMoment& m) override { return mass_ * m.payload_inertia; }

 private:
  double mass_ = 0;  // [kg]
};

class PositionPeriodicEffect : public CopyableEffect<PositionPeriodicEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    a_ = p[0];
    b_ = p[1];
    wave_ = 2 * M_PI / p[2];
  }
  double Torque(const JointMoment& m, DryFriction&) override {
    return a_ * std::cos(wave_ * m.q) + b_ * std::sin(wave_ * m.q);
  }

 private:
  double a_ = 0, b_ = 0;  // [Nm]
  double wave_ = 1;       // [rad/rad]
};

class PositionDependentTorqueEffect : public CopyableEffect<PositionDependentTorqueEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    for (int i = 0; i < 3; ++i) c_[i] = p[i];
  }
  double Torque(const JointMoment& m, DryFriction&) override {
    return m.q * (c_[0] + m.q * (c_[1] + m.q * c_[2]));
  }

 private:
  double c_[3] = {0, 0, 0};  // [Nm/rad, Nm/rad^2, Nm/rad^3]
};

class CableSpringEffect : public CopyableEffect<CableSpringEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    k_ = p[0];
    q0_ = p[1];
  }
  double Torque(const JointMoment& m, DryFriction&) override { return -k_ * (m.q - q0_); }

 private:
  double k_ = 0;   // [Nm/rad]
  double q0_ = 0;  // [rad]
};

class CrossJointCouplingEffect : public CopyableEffect<CrossJointCouplingEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { k_ = p[0]; }
  double Torque(const JointMoment& m, DryFriction&) override { return -k_ * m.coupled_q; }

 private:
  double k_ = 0;  // [Nm/rad]
};

class CrossJointInertiaEffect : public CopyableEffect<CrossJointInertiaEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { inertia_ = p[0]; }
  double Torque(const JointMoment& m, DryFriction&) override { return -inertia_ * m.coupled_ddq; }

 private:
  double inertia_ = 0;  // [kg m^2]
};

class BaseTiltEffect : public CopyableEffect<BaseTiltEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    x_ = p[0];
    y_ = p[1];
  }
  unsigned Reads() const override { return kTiltField; }
  double Torque(const JointMoment& m, DryFriction&) override {
    return -(x_ * m.tilt_gravity[0] + y_ * m.tilt_gravity[1]);
  }

 private:
  double x_ = 0, y_ = 0;  // [rad]
};

}  // namespace

std::unique_ptr<JointEffect> GravityError() { return std::make_unique<GravityErrorEffect>(); }
std::unique_ptr<JointEffect> Payload() { return std::make_unique<PayloadEffect>(); }
std::unique_ptr<JointEffect> PositionPeriodicTorque() {
  return std::make_unique<PositionPeriodicEffect>();
}
std::unique_ptr<JointEffect> PositionDependentTorque() {
  return std::make_unique<PositionDependentTorqueEffect>();
}
std::unique_ptr<JointEffect> CableSpring() { return std::make_unique<CableSpringEffect>(); }
std::unique_ptr<JointEffect> CrossJointCoupling() {
  return std::make_unique<CrossJointCouplingEffect>();
}
std::unique_ptr<JointEffect> CrossJointInertia() {
  return std::make_unique<CrossJointInertiaEffect>();
}
std::unique_ptr<JointEffect> BaseTilt() { return std::make_unique<BaseTiltEffect>(); }

}  // namespace robostress::effects
