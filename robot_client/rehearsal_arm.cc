#include "robot_client/rehearsal_arm.h"

#include <cmath>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {
constexpr int64_t kSample_ns = 5'000'000;
}  // namespace

ArmLimits PiperLimits() {
  ArmLimits limits;
  for (int j = 0; j < limits.axes.joints; ++j) {
    const JointDescription& joint = kPiper.joints[j];
    limits.lower[j] = joint.lower;
    limits.upper[j] = joint.upper;
    limits.max_velocity[j] = joint.max_velocity;
    limits.max_acceleration[j] = joint.max_acceleration;
  }
  const int opening = limits.axes.opening();
  limits.upper[opening] = 0.07;
  limits.max_velocity[opening] = 0.5;
  limits.max_acceleration[opening] = 10;
  return limits;
}

absl::Status RehearsalArm::Connect() {
  sample_ = {};
  sample_.position = target_ = options_.start;
  sample_.sequence = 1;
  sample_.stamp_ns = moved_ns_ = clock_->now_ns();
  return absl::OkStatus();
}

absl::Status RehearsalArm::Enable(const std::function<bool()>&) {
  target_ = sample_.position;
  sample_.enabled = true;
  return absl::OkStatus();
}

absl::Status RehearsalArm::Disable() {
  sample_.enabled = false;
  return absl::OkStatus();
}

void RehearsalArm::Poll() {
  const int64_t samples = (clock_->now_ns() - moved_ns_) / kSample_ns;
  if (samples <= 0) return;
  const double dt = static_cast<double>(samples * kSample_ns) * 1e-9;
  const double share = -std::expm1(-dt / options_.lag_s);
  for (int i = 0; i < options_.limits.axes.count(); ++i) {
    const double step = sample_.enabled ? share * (target_[i] - sample_.position[i]) : 0;
    sample_.position[i] += step;
    sample_.velocity[i] = i < options_.limits.axes.joints ? step / dt : 0;
  }
  moved_ns_ += samples * kSample_ns;
  sample_.stamp_ns = moved_ns_;
  sample_.sequence += static_cast<uint64_t>(samples);
}

absl::Status RehearsalArm::Send(const ArmCommand& command) {
  target_ = command.position;
  return absl::OkStatus();
}

absl::Status RehearsalArm::QuickStop() {
  target_ = sample_.position;
  return absl::OkStatus();
}

std::string RehearsalArm::description() const {
  return absl::StrCat("rehearsal arm, lag ", options_.lag_s, " s");
}

}  // namespace robostress
