#pragma once

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "common/atomic_file.h"
#include "common/robot_description.h"
#include "robot_client/bridge/arm_chain.h"

namespace robostress::bridge {

// The arm of seven_joints.urdf. Tests run in the root of the sources.
inline std::string SevenUrdf() {
  const auto text = ReadFile("tests/robot_client/bridge/seven_joints.urdf");
  EXPECT_TRUE(text.ok()) << text.status();
  return text.value_or("");
}

inline std::vector<std::string> SevenNames() {
  std::vector<std::string> names;
  for (int j = 1; j <= 7; ++j) names.push_back("panda_joint" + std::to_string(j));
  return names;
}

inline ModelOptions SevenModel() {
  ModelOptions options;
  options.file = "seven_joints.urdf";
  options.tool = "tcp";
  options.radius = 0.05;
  return options;
}

inline ArmLimits SevenLimits() {
  ArmLimits limits;
  limits.axes = {7, true};
  for (int j = 0; j < 7; ++j) {
    limits.lower[j] = kPanda.joints[j].lower;
    limits.upper[j] = kPanda.joints[j].upper;
  }
  limits.upper[7] = 0.08;
  return limits;
}

}  // namespace robostress::bridge
