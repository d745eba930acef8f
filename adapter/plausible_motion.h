#pragma once

#include <vector>

#include "common/types.h"

namespace robostress {

// What no arm on a bench measures and no controller is told: a broken sensor, a unit mixed up, a
// client that lies. One step that shows it counts as not measured (ExecutedChunk::masked), so that
// no estimate learns from it. Far above what a robot does (a Panda: 1.7 m/s, 2.6 rad/s), so that
// nothing real is lost; per control step, whatever its period.
struct PlausibleMotion {
  static constexpr double kPosition = 10;     // |p_base_tool| [m]
  static constexpr double kDisplacement = 1;  // of the tool in one control step [m]
  static constexpr double kRotation = 2.5;    // of the tool in one control step [rad]
  static constexpr double kJoint = 100;       // |q| of each joint [rad]
  static constexpr double kJointStep = 3;     // of each joint in one control step [rad]
  static constexpr double kJointSpeed = 100;  // |dq| of each joint [rad/s]
  static constexpr double kGripper = 1;       // |opening| [m]
  static constexpr float kCommand = 1000;     // |entry| of a command, environment units
};

// [steps] which steps touch a state, or carry a command, that PlausibleMotion excludes; empty:
// none.
std::vector<bool> ImpossibleSteps(const ExecutedChunk& chunk);

// The chunk with `impossible` steps masked beside those that its client masked.
ExecutedChunk WithMasked(ExecutedChunk chunk, const std::vector<bool>& impossible);

}  // namespace robostress
