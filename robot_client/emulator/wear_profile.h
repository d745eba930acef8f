#pragma once

#include <array>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/joint_errors/scenarios.h"
#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// What distinguishes one Piper from another: execution errors of the shared library at its joints,
// the share of gravity that its controller knows, and how late a target takes effect.
struct WearProfile {
  std::string name;
  std::vector<ScenarioEffect> effects;  // library effects with physical values; joint 0 is J1
  JointVector gravity_feedforward{};    // share of the unloaded arm's gravity torque, 0 .. 1
  // Whether the encoders sit on the motors, before backlash and compliance, and not on the joints.
  bool motor_encoders = false;
  double command_lag_s = 0;  // from a target's frame to the controller that plans it
};

// "new" and "used_one_year"; every number with its source in wear_profile.cc. No Piper's friction,
// backlash or lag has been published: the profiles are built from published values of like drives
// and of the Piper's behaviour, not fitted to the residuals that the paper measured. A name that
// ends in .yaml is a scenario file of one's own (common/joint_errors/scenario_file.h) over the arm
// of "new" without its effects.
absl::StatusOr<WearProfile> MakeWearProfile(const std::string& name);

}  // namespace robostress::piper
