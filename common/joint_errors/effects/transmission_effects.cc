#include <cmath>

#include "common/joint_errors/effects/backlash.h"
#include "common/joint_errors/effects/compliance.h"
#include "common/joint_errors/effects/effect_makers.h"

namespace robostress::effects {
namespace {

class TransmissionErrorEffect : public CopyableEffect<TransmissionErrorEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    a_ = p[0];
    b_ = p[1];
    wave_ = 2 * M_PI / p[2];
  }
  double Offset(const JointMoment& m) override {
    return a_ * std::cos(wave_ * m.q) + b_ * std::sin(wave_ * m.q);
  }

 private:
  double a_ = 0, b_ = 0;  // [rad]
  double wave_ = 1;       // [rad/rad]
};

class BacklashEffect : public CopyableEffect<BacklashEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { law_.B = p[0]; }
  void Reset(const JointMoment& m) override { gap_.Reset(m.q); }
  bool HasState() const override { return true; }
  double Offset(const JointMoment& m) override { return gap_.Step(law_, m.q); }

 private:
  JointErrorParameters law_;
  Backlash gap_;
};

// The deflection of compliance.h. Numbers of the library: stiffness, natural frequency and damping
// ratio, M_eff = K / (2 pi f)^2, D = 2 zeta sqrt(K M_eff); else K, M_eff and D themselves.
template <bool kByFrequency>
class ComplianceEffect : public CopyableEffect<ComplianceEffect<kByFrequency>> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    const double omega = 2 * M_PI * p[1];
    law_.K = p[0];
    law_.M_eff = kByFrequency ? p[0] / (omega * omega) : p[1];
    law_.D = kByFrequency ? 2 * p[2] * p[0] / omega : p[2];
  }
  void Reset(const JointMoment& m) override {
    deflection_.Reset(Compliance::Equilibrium(law_, m.drive));
  }
  bool HasState() const override { return true; }
  double Offset(const JointMoment& m) override { return deflection_.Step(law_, m.drive, m.h); }

 private:
  JointErrorParameters law_;
  Compliance deflection_;
};

}  // namespace

std::unique_ptr<JointEffect> TransmissionError() {
  return std::make_unique<TransmissionErrorEffect>();
}
std::unique_ptr<JointEffect> BacklashGap() { return std::make_unique<BacklashEffect>(); }
std::unique_ptr<JointEffect> TransmissionCompliance() {
  return std::make_unique<ComplianceEffect<true>>();
}
std::unique_ptr<JointEffect> ComplianceOfMass() {
  return std::make_unique<ComplianceEffect<false>>();
}

}  // namespace robostress::effects
