#pragma once

#include <cstdint>
#include <string>

#include "common/clock.h"
#include "robot_client/robot_arm.h"

namespace robostress {

struct RehearsalArmOptions {
  double lag_s = 0.1;                                    // first-order lag of every axis [s]
  ArmVector start{0.0, 1.2, -1.0, 0.0, 0.5, 0.0, 0.05};  // joints [rad], gripper [m]
  // As a Piper's: positions of its published description, 3 rad/s, 5 rad/s^2, a 70 mm gripper.
  ArmLimits limits{{-2.6179, 0, -2.967, -1.745, -1.22, -2.0944, 0},
                   {2.6179, 3.14, 0, 1.745, 1.22, 2.0944, 0.07},
                   {3, 3, 3, 3, 3, 3, 0.5},
                   {5, 5, 5, 5, 5, 5, 10}};
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
