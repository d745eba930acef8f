#include "common/rollout/motion_smoothness.h"

#include <gtest/gtest.h>

#include <cmath>
#include <functional>

namespace robostress {
namespace {

constexpr double kT = 0.05;

// Chunks of `rows` steps along x(t), commands (2, 0, gripper) of chunk 0, (2, 3, gripper) of 1 ...
std::vector<ExecutedChunk> Along(const std::function<double(double)>& x, int chunks, int rows) {
  const auto state = [&](int step) {
    RobotState s;
    s.stamp_s = kT * step;
    s.tool.p_base_tool = {x(s.stamp_s), 0.1, 0.2};
    return s;
  };
  std::vector<ExecutedChunk> out;
  for (int k = 0; k < chunks; ++k) {
    ExecutedChunk chunk;
    for (int i = 0; i < rows; ++i) {
      ExecutedStep step;
      step.before = state(k * rows + i);
      step.sent_command =
          Eigen::Vector3f(2, 3.0f * static_cast<float>(k), 7.0f * static_cast<float>(k));
      chunk.steps.push_back(step);
    }
    chunk.final_state = state((k + 1) * rows);
    out.push_back(chunk);
  }
  return out;
}

TEST(MotionSmoothnessTest, JerkOfACubicIsItsThirdDerivative) {
  const auto cubic = [](double t) { return 2 * t * t * t - t * t + 3 * t; };
  EXPECT_NEAR(SmoothnessOf(Along(cubic, 3, 4), kT).jerk, 12, 1e-6);
  EXPECT_NEAR(SmoothnessOf(Along([](double t) { return t * t; }, 3, 4), kT).jerk, 0, 1e-6);
}

TEST(MotionSmoothnessTest, JumpIsTheChangeOfTheCommandBetweenChunksWithoutTheGripper) {
  EXPECT_NEAR(SmoothnessOf(Along([](double) { return 0.0; }, 3, 4), kT).jump, 3, 1e-6);
  EXPECT_EQ(SmoothnessOf(Along([](double) { return 0.0; }, 1, 4), kT).jump, 0);
}

TEST(MotionSmoothnessTest, NothingIsTakenOverAGap) {
  std::vector<ExecutedChunk> chunks = Along([](double) { return 0.0; }, 2, 2);
  for (ExecutedStep& step : chunks[1].steps) {
    step.before.stamp_s += 1;
    step.before.tool.p_base_tool.x() += 5;
  }
  chunks[1].final_state.tool.p_base_tool.x() += 5;
  const MotionSmoothness smoothness = SmoothnessOf(chunks, kT);
  EXPECT_EQ(smoothness.jerk, 0);
  EXPECT_EQ(smoothness.jump, 0);
}

TEST(MotionSmoothnessTest, OfNothingIsZero) {
  EXPECT_EQ(SmoothnessOf({}, kT).jerk, 0);
  EXPECT_EQ(SmoothnessOf({}, kT).jump, 0);
}

}  // namespace
}  // namespace robostress
