#include "sim_worker/arm_sensing.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "common/joint_errors/joint_chain.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

// States that `options` let an arm under `scenario` see, and what they are in truth, from the
// episode's start on.
struct Seen {
  std::vector<RobotState> sensed, truth;
  std::vector<Eigen::VectorXd> motors;
};

Seen Watch(const SensingOptions& options, const std::string& scenario, int initial_state = 0) {
  const auto sim = MakeTestSim();
  UseScenario(*sim, scenario);
  EXPECT_TRUE(sim->Reset(HomeState(*sim), PandaHome()).ok());
  auto sensing = ArmSensing::Create(sim->shared_model(), options);
  EXPECT_TRUE(sensing.ok()) << sensing.status();
  (*sensing)->StartEpisode(initial_state);
  Seen seen;
  for (int step = 0; step < 20; ++step) {
    if (step > 0) {
      EXPECT_TRUE(sim->Step(Command(0.5, -0.3, 0.4)).ok());
    }
    seen.truth.push_back(sim->Measure());
    seen.sensed.push_back((*sensing)->Measure(*sim));
    Eigen::VectorXd motor = seen.truth.back().q;
    for (int i = 0; i < 7; ++i) motor[i] = sim->joint_chain().MotorAngle(i, motor[i]);
    seen.motors.push_back(motor);
  }
  return seen;
}

double Apart(const RobotState& a, const RobotState& b) {
  return (a.tool.p_base_tool - b.tool.p_base_tool).norm() +
         a.tool.q_base_tool.angularDistance(b.tool.q_base_tool);
}

TEST(ArmSensing, DelayShowsTheStateOfThenAndTheFirstOneBeforeThat) {
  const Seen seen = Watch({.delay = 3}, "aged_joint_uniform");
  for (int step = 0; step < 20; ++step) {
    const RobotState& then = seen.truth[std::max(0, step - 3)];
    EXPECT_EQ(seen.sensed[step].q, then.q) << step;
    EXPECT_EQ(seen.sensed[step].stamp_s, then.stamp_s) << step;
    EXPECT_EQ(Apart(seen.sensed[step], then), 0) << step;
  }
}

TEST(ArmSensing, MotorEncodersSeeThePoseWithoutBacklashAndCompliance) {
  const Seen worn = Watch({.encoders = Encoders::kMotor}, "aged_joint_uniform");
  double widest = 0;
  for (int step = 0; step < 20; ++step) {
    EXPECT_EQ(worn.sensed[step].q, worn.motors[step]) << step;
    EXPECT_EQ(worn.sensed[step].gripper, worn.truth[step].gripper);
    widest = std::max(widest, Apart(worn.sensed[step], worn.truth[step]));
  }
  EXPECT_GT(widest, 0.005) << "[m], [rad]";
  const Seen clean = Watch({.encoders = Encoders::kMotor}, "clean");
  for (int step = 0; step < 20; ++step)
    EXPECT_LT(Apart(clean.sensed[step], clean.truth[step]), 1e-12) << step;
}

TEST(ArmSensing, NoiseIsOfTheSizeAskedForAndOfTheInitialState) {
  const SensingOptions noisy = {.noise = 1e-3};
  const Seen seen = Watch(noisy, "clean"), again = Watch(noisy, "clean"),
             other = Watch(noisy, "clean", 1);
  double squares = 0;
  for (int step = 0; step < 20; ++step) {
    squares += (seen.sensed[step].q - seen.truth[step].q).squaredNorm() / (20 * 7);
    EXPECT_EQ(seen.sensed[step].q, again.sensed[step].q) << step;
    EXPECT_NE(seen.sensed[step].q, other.sensed[step].q) << step;
    EXPECT_GT(Apart(seen.sensed[step], seen.truth[step]), 1e-6) << "the pose is that of the angles";
  }
  EXPECT_NEAR(std::sqrt(squares), 1e-3, 2e-4);
}

}  // namespace
}  // namespace robostress
