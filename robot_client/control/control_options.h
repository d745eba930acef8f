#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "adapter/disturbance_observer.h"
#include "robot_client/arm_model.h"
#include "robot_client/control/chunk_player.h"
#include "robot_client/control/command_limiter.h"
#include "robot_client/control/press_watch.h"
#include "robot_client/control/watchdogs.h"

namespace robostress {

struct ControlOptions {
  double rate_hz = 30;          // control ticks per second
  double gripper_effort = 1.0;  // [Nm]
  double retry_s = 0.2;         // after a failed prediction, until the next is asked for
  bool observer = false;        // disturbance observer
  DisturbanceObserverOptions disturbance_observer;
  double smoothing = 0;  // share of the last sent joint targets in the next
  PlayerOptions player;
  LimiterOptions limits;
  WatchdogOptions watchdogs;
  PressOptions press;
  WorkspaceOptions workspace;
  // False in simulated studies, as they were recorded: nothing is asked of an arm that starts, and
  // pressing, blocking, delay and workspace are not watched.
  bool guards = true;

  template <class V>
  void Visit(V& v) {
    v.Field("rate_hz", rate_hz, "control ticks per second");
    v.Field("gripper_effort", gripper_effort, "most torque of the gripper [Nm]");
    v.Field("retry_s", retry_s, "after a failed prediction, until the next is asked for [s]");
    v.Field("observer", observer, "correct commands by the disturbance observer");
    v.Section("disturbance_observer", disturbance_observer, "the DOB baseline");
    v.Late("smoothing", smoothing, 0.0, "share of the last sent joint targets in the next");
    v.Section("player", player, "how chunks are played");
    v.Section("limits", limits, "bounds on what is sent");
    v.Section("watchdogs", watchdogs, "when the arm is held");
    v.Section("press", press, "when the arm presses against something");
    v.Section("workspace", workspace, "where the arm may be");
  }
};

// INVALID_ARGUMENT names option, value and range where a value of the watchdogs or of a press lies
// outside of what still guards something and the option is not among `given_up`, which a person
// gives up by name.
absl::Status CheckGuards(const WatchdogOptions& watchdogs, const PressOptions& press,
                         const std::vector<std::string>& given_up);

// INVALID_ARGUMENT names option, value and range. What depends on an arm's limits is
// CommandLimiter::Configure's to check.
absl::Status CheckControlOptions(const ControlOptions& options, int joints);

}  // namespace robostress
