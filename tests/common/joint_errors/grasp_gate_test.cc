#include "common/joint_errors/grasp_gate.h"

#include <gtest/gtest.h>

namespace robostress {
namespace {

double ControlStep(GraspGate& gate, bool held) {
  gate.BeginControlStep(held);
  double value = 0;
  for (int i = 0; i < 25; ++i) value = gate.SubStep(0.002);
  return value;
}

TEST(GraspGate, OpensLinearlyOverATenthOfASecond) {
  GraspGate gate;
  EXPECT_EQ(ControlStep(gate, false), 0);
  gate.BeginControlStep(true);
  for (int i = 1; i <= 25; ++i) EXPECT_NEAR(gate.SubStep(0.002), 0.02 * i, 1e-12);
  gate.BeginControlStep(true);
  for (int i = 26; i <= 50; ++i) EXPECT_NEAR(gate.SubStep(0.002), 0.02 * i, 1e-12);
  EXPECT_EQ(gate.value(), 1.0);
  EXPECT_EQ(ControlStep(gate, true), 1.0);
}

TEST(GraspGate, ReleasesThreeControlStepsAfterTheObjectIsLetGo) {
  GraspGate gate;
  for (int i = 0; i < 4; ++i) ControlStep(gate, true);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(ControlStep(gate, false), 1.0) << i;
  EXPECT_EQ(ControlStep(gate, false), 0.0);
  // A new grasp ramps in again.
  EXPECT_NEAR(ControlStep(gate, true), 0.5, 1e-12);
}

TEST(GraspGate, AFlickeringContactDoesNotFireTheRampAgain) {
  GraspGate gate;
  for (int i = 0; i < 4; ++i) ControlStep(gate, true);
  for (int i = 0; i < 20; ++i) EXPECT_EQ(ControlStep(gate, i % 4 == 0), 1.0) << i;
}

}  // namespace
}  // namespace robostress
