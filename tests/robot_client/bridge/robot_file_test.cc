#include "robot_client/bridge/robot_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "tests/robot_client/bridge/scripted_driver.h"

namespace robostress::bridge {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

std::string Refused(const std::string& yaml) {
  const auto robot = ParseBridgeRobot("arm.yaml", yaml);
  EXPECT_FALSE(robot.ok());
  return std::string(robot.status().message());
}

std::string With(const std::string& from, const std::string& to) {
  const std::string changed = absl::StrReplaceAll(kFiveServos, {{from, to}});
  EXPECT_NE(changed, kFiveServos) << from;
  return changed;
}

TEST(BridgeRobotFile, ReadsAxesLimitsAndUnits) {
  const auto robot = ParseBridgeRobot("arm.yaml", kFiveServos);
  ASSERT_TRUE(robot.ok()) << robot.status();
  EXPECT_EQ(robot->axes.joints, 5);
  EXPECT_EQ(robot->axes.count(), 6);
  EXPECT_FALSE(robot->axes.has(5)) << "there is no J6";
  EXPECT_EQ(robot->axes.slot(5), kArmJoints) << "the gripper is the last axis";
  EXPECT_EQ(robot->limits.upper[0], 1.8);
  EXPECT_EQ(robot->limits.upper[kArmJoints], 0.08);
  EXPECT_NEAR(robot->conversions[0].Ours(90), M_PI / 2, 1e-12);
  EXPECT_NEAR(robot->conversions[1].Ours(90), 0.5 - M_PI / 2, 1e-12);
  EXPECT_NEAR(robot->conversions[3].Ours(-50), -1, 1e-12);
  EXPECT_NEAR(robot->conversions[5].Ours(50), 0.04, 1e-12);
  for (int i = 0; i < 6; ++i)
    EXPECT_NEAR(robot->conversions[i].Drivers(robot->conversions[i].Ours(17)), 17, 1e-9);
  EXPECT_EQ(HomeInSlots(*robot), (std::vector<double>{0, 0.2, 0.3, 0, 0, 0, 0.04}));
}

TEST(BridgeRobotFile, TheExampleIsRead) {
  const auto robot = LoadBridgeRobot("robot_client/bridge/so101.yaml");
  ASSERT_TRUE(robot.ok()) << robot.status();
  EXPECT_FALSE(robot->simulated);
  EXPECT_EQ(LoadBridgeRobot("nowhere.yaml").status().code(), absl::StatusCode::kNotFound);
}

TEST(BridgeRobotFile, NamesFileFieldValueAndRemedy) {
  EXPECT_THAT(Refused(With("velocity: 2,", "velocity: 20,")),
              AllOf(HasSubstr("arm.yaml: joints[0].velocity is 20"), HasSubstr("10 rad/s")));
  EXPECT_THAT(Refused(With("lower: -1.8", "lower: 1.9")), HasSubstr("must be below"));
  EXPECT_THAT(
      Refused(With("acceleration: 8}\n  - {name: lift", "acceleration: 0}\n  - {name: lift")),
      HasSubstr("joints[0].acceleration is 0"));
  EXPECT_THAT(Refused(With("unit: radians", "unit: grads")), HasSubstr("must be one of: radians"));
  EXPECT_THAT(Refused(With("unit: radians", "unit: metres")), HasSubstr("joints[2].unit"));
  EXPECT_THAT(Refused(With("sign: -1", "sign: 2")), HasSubstr("joints[1].sign is 2"));
  EXPECT_THAT(Refused(With("driver_range: [-100, 100], ", "")), HasSubstr("driver_range is []"));
  EXPECT_THAT(Refused(With("[-100, 100]", "[5, 5]")), HasSubstr("two different numbers"));
  EXPECT_THAT(Refused(With("name: roll", "name: pan")), HasSubstr("another axis has"));
  EXPECT_THAT(Refused(With("name: roll", "nmae: roll")), HasSubstr("nmae"));
  EXPECT_THAT(Refused(With("home: [0, ", "home: [")), HasSubstr("home has 5 numbers, must have 6"));
  EXPECT_THAT(Refused(With("home: [0, ", "home: [2, ")), HasSubstr("home[0] is 2"));
  EXPECT_THAT(Refused(With("rate_hz: 30", "rate_hz: 3000")), HasSubstr("rate_hz is 3000"));
  EXPECT_THAT(Refused(With("rate_hz: 30", "rate_hz: .nan")), HasSubstr("rate_hz"));
  EXPECT_THAT(Refused(With("rate_hz: 30", "rate: 30")), HasSubstr("rate_hz"));
  EXPECT_THAT(Refused(With("watchdog_s: 0.5", "watchdog_s: 9")),
              HasSubstr("driver.watchdog_s is 9"));
  EXPECT_THAT(Refused(With("simulated: true", "simulated: true\nsimulated: true")),
              HasSubstr("twice"));
  EXPECT_THAT(Refused("joints: 5"), HasSubstr("joints is missing, or no list"));
  EXPECT_THAT(Refused("joints: [5]"), HasSubstr("joints[0] must be a section"));
  EXPECT_THAT(Refused(": ["), HasSubstr("arm.yaml"));
}

TEST(BridgeRobotFile, SevenJointsAreRefusedWithTheLimit) {
  std::string yaml = "name: seven\njoints:\n";
  for (int j = 0; j < 7; ++j)
    absl::StrAppend(&yaml, "  - {name: j", j,
                    ", unit: radians, lower: -1, upper: 1, velocity: 1, acceleration: 5}\n");
  EXPECT_THAT(Refused(yaml), AllOf(HasSubstr("joints has 7 entries"), HasSubstr("six joints")));
}

TEST(BridgeRobotFile, SaysWhatADriverLacks) {
  ExpectedDriver expected;
  Welcome welcome;
  EXPECT_THAT(Missing(expected, welcome), AllOf(HasSubstr("hold"), HasSubstr("on_silence")));
  welcome.hold = true;
  welcome.on_silence = OnSilence::kHold;
  welcome.watchdog_s = 0.25;
  EXPECT_EQ(Missing(expected, welcome), "");
  welcome.watchdog_s = 0.7;
  EXPECT_THAT(Missing(expected, welcome), HasSubstr("it waits 0.7 s, at most 0.5 s"));
  welcome.watchdog_s = 0;
  EXPECT_THAT(Missing(expected, welcome), HasSubstr("on_silence"));
  expected.on_silence = false;
  EXPECT_EQ(Missing(expected, welcome), "");
  expected.stop = expected.torque_off = expected.measures_effort = expected.measures_velocity =
      true;
  EXPECT_EQ(Missing(expected, welcome), "stop, torque_off, measures_velocity, measures_effort");
}

}  // namespace
}  // namespace robostress::bridge
