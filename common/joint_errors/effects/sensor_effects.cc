#include "common/joint_errors/effects/effect_makers.h"

namespace robostress::effects {
namespace {

class EncoderGainEffect : public CopyableEffect<EncoderGainEffect> {
 public:
  void SetParameters(absl::Span<const double> p) override { error_ = p[0]; }
  double Reading(double q_link) override { return q_link * (1 + error_); }

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

}  // namespace

std::unique_ptr<JointEffect> EncoderGain() { return std::make_unique<EncoderGainEffect>(); }
std::unique_ptr<JointEffect> EncoderOffset() { return std::make_unique<EncoderOffsetEffect>(); }

}  // namespace robostress::effects
