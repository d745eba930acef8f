#pragma once

#include <cstdint>
#include <string>

#include "common/clock.h"
#include "common/robot_description.h"
#include "robot_client/robot_arm.h"

namespace robostress {

static_assert(ArmAxes().joints == kPiper.joints.size());
// As its description says; the gripper opens 70 mm, at 0.5 m/s and 10 m/s^2.
ArmLimits PiperLimits();

struct RehearsalArmOptions {
  double lag_s = 0.1;                                    // first-order lag of every axis [s]
  ArmVector start{0.0, 1.2, -1.0, 0.0, 0.5, 0.0, 0.05};  // joints [rad], gripper [m]
  ArmLimits limits = PiperLimits();
};

// An arm that is not there: every axis follows its target with a first-order lag, samples come
// every 5 ms. For rehearsing a set-up (server, cameras, episode, record) before an arm has power,
// and for timing the client alone.
class RehearsalArm : public RobotArm {
 public:
  RehearsalArm(const RehearsalArmOptions& options, const Clock* clock)
      : options_(options), clock_(clock) {}

  absl::Status Connect() override;
  using RobotArm::Enable;
  absl::Status Enable(const std::function<bool()>& cancelled) override;
  absl::Status Disable() override;
  void Poll() override;
  ArmSnapshot Latest() const override { return sample_; }  // one thread here
  absl::Status Send(const ArmCommand& command) override;
  absl::Status QuickStop() override;
  ArmLimits limits() const override { return options_.limits; }
  std::string description() const override;

 protected:
  const RehearsalArmOptions options_;
  const Clock* const clock_;
  ArmSnapshot sample_;
  ArmVector target_{};
  int64_t moved_ns_ = 0;  // time up to which the axes have moved
};

}  // namespace robostress
