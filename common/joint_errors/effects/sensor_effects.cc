#include <cmath>

#include "common/joint_errors/effects/effect_makers.h"

namespace robostress::effects {
namespace {

class EncoderGainEffect : public CopyableEffect<EncoderGainEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { error_ = p[0]; }
  double Reading(double q_link) override { return q_link * (1 + error_); }
  double ReadingSlope(double) override { return 1 + error_; }

 private:
  double error_ = 0;
};

class EncoderOffsetEffect : public CopyableEffect<EncoderOffsetEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { offset_ = p[0]; }
  double Reading(double q_link) override { return q_link + offset_; }

 private:
  double offset_ = 0;  // [rad]
};

// A disc that turns about another point than its centre reads one period a turn, as large as the
// distance over the radius.
class EncoderEccentricityEffect : public CopyableEffect<EncoderEccentricityEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override {
    a_ = p[0];
    b_ = p[1];
    wave_ = 2 * M_PI / p[2];
  }
  double Reading(double q_link) override {
    return q_link + a_ * std::cos(wave_ * q_link) + b_ * std::sin(wave_ * q_link);
  }
  double ReadingSlope(double q_link) override {
    return 1 + wave_ * (b_ * std::cos(wave_ * q_link) - a_ * std::sin(wave_ * q_link));
  }

 private:
  double a_ = 0, b_ = 0;  // [rad]
  double wave_ = 1;       // [rad/rad]
};

}  // namespace

std::unique_ptr<JointEffect> EncoderGain() { return std::make_unique<EncoderGainEffect>(); }
std::unique_ptr<JointEffect> EncoderOffset() { return std::make_unique<EncoderOffsetEffect>(); }
std::unique_ptr<JointEffect> EncoderEccentricity() {
  return std::make_unique<EncoderEccentricityEffect>();
}

}  // namespace robostress::effects
