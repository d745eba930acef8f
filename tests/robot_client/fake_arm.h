#pragma once

#include <algorithm>

#include "robot_client/rehearsal_arm.h"

namespace robostress {

// A rehearsal arm that can fail in every way the client watches for.
class FakeArm : public RehearsalArm {
 public:
  explicit FakeArm(const Clock* clock, const RehearsalArmOptions& options = {})
      : RehearsalArm(options, clock) {}

  using RobotArm::Enable;
  absl::Status Enable(const std::function<bool()>& cancelled) override {
    ++enables;
    return refuse_enable ? absl::UnavailableError("no power") : RehearsalArm::Enable(cancelled);
  }
  absl::Status Disable() override {
    ++disables;
    return RehearsalArm::Disable();
  }
  void Poll() override {
    if (silent) {
      moved_ns_ = clock_->now_ns();
    } else {
      RehearsalArm::Poll();
    }
    for (int j = 0; j < options_.limits.axes.joints && drift != 0; ++j) {  // carried by hand
      sample_.position[j] += drift / 30;
      sample_.velocity[j] = drift;
    }
    sample_.effort = effort;
    sample_.has_effort = true;
    sample_.faults = faults;
    if (lost_enable) sample_.enabled = false;
    if (blocked) {
      sample_.position = blocked_at_;
      sample_.velocity.fill(0);
    }
    double& opening = sample_.position[options_.limits.axes.opening()];
    opening = std::max(opening, grasped);
    if (!blocked) blocked_at_ = sample_.position;
    for (int j = 0; j < options_.limits.axes.joints; ++j) sample_.position[j] += bias;
    if (bias != 0) bias = 0;
  }
  void Acknowledge() override { ++acknowledged; }
  absl::Status Send(const ArmCommand& command) override {
    if (refuse_send) return refused_;
    ++sends;
    last = command;
    return RehearsalArm::Send(command);
  }
  absl::Status QuickStop() override {
    ++quick_stops;
    return RehearsalArm::QuickStop();
  }

  void blocked_at(int joint, double position) { blocked_at_[joint] = position; }

  bool silent = false, refuse_send = false, refuse_enable = false, lost_enable = false;
  bool blocked = false;  // something holds the joints
  double grasped = 0;    // [m] between the fingers: they close no further
  double bias = 0;       // [rad], added once to every joint: something pushed the arm
  double drift = 0;      // [rad/s], somebody moves the arm, 30 polls a second
  ArmVector effort{};
  uint32_t faults = 0;
  int acknowledged = 0;
  int enables = 0, disables = 0, sends = 0, quick_stops = 0;
  ArmCommand last;

 private:
  ArmVector blocked_at_{};
  const absl::Status refused_ = absl::UnavailableError("bus-off");
};

}  // namespace robostress
