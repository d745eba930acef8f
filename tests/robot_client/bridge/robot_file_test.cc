#include "robot_client/bridge/robot_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/robot_description.h"
#include "robot_client/bridge/driver_abilities.h"
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
  const ArmAxes& axes = robot->limits.axes;
  EXPECT_EQ(axes.joints, 5);
  EXPECT_EQ(axes.count(), 6);
  EXPECT_EQ(axes.opening(), 5) << "the gripper is the last axis";
  EXPECT_EQ(axes.text(), "5 joints and a gripper");
  EXPECT_EQ(robot->limits.upper[0], 1.8);
  EXPECT_EQ(robot->limits.upper[axes.opening()], 0.08);
  EXPECT_NEAR(robot->conversions[0].Ours(90), M_PI / 2, 1e-12);
  EXPECT_NEAR(robot->conversions[1].Ours(90), 0.5 - M_PI / 2, 1e-12);
  EXPECT_NEAR(robot->conversions[3].Ours(-50), -1, 1e-12);
  EXPECT_NEAR(robot->conversions[5].Ours(50), 0.04, 1e-12);
  for (int i = 0; i < 6; ++i)
    EXPECT_NEAR(robot->conversions[i].Drivers(robot->conversions[i].Ours(17)), 17, 1e-9);
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

TEST(BridgeRobotFile, SevenJointsAreReadAndEightRefusedWithTheLimit) {
  const auto robot = ParseBridgeRobot("arm.yaml", SevenJoints());
  ASSERT_TRUE(robot.ok()) << robot.status();
  EXPECT_EQ(robot->limits.axes.joints, 7);
  EXPECT_EQ(robot->limits.axes.count(), 8);
  EXPECT_EQ(robot->limits.axes.name(6), "J7");
  EXPECT_EQ(robot->limits.axes.name(7), "gripper");
  EXPECT_EQ(robot->limits.upper[6], 2);
  EXPECT_EQ(robot->limits.upper[7], 0.08);
  EXPECT_NEAR(robot->conversions[7].Ours(0.01), 0.02, 1e-15) << "two fingers";
  const std::string eight = absl::StrReplaceAll(
      SevenJoints(), {{"joints:\n",
                       "joints:\n  - {name: j0, unit: radians, lower: -1, upper: 1, velocity: 1, "
                       "acceleration: 5}\n"}});
  EXPECT_THAT(Refused(eight), AllOf(HasSubstr("joints has 8 entries, must have 1 to 7"),
                                    HasSubstr("that the driver can keep still")));
}

TEST(BridgeRobotFile, AFrankasLimitsAreInsideThoseOfBothArms) {
  const auto robot = LoadBridgeRobot("robot_client/bridge/franka.yaml");
  ASSERT_TRUE(robot.ok()) << robot.status();
  EXPECT_FALSE(robot->simulated);
  ASSERT_EQ(robot->limits.axes.joints, 7);
  constexpr double kFr3[7][2] = {{-2.7437, 2.7437},  {-1.7837, 1.7837}, {-2.9007, 2.9007},
                                 {-3.0421, -0.1518}, {-2.8065, 2.8065}, {0.5445, 4.5169},
                                 {-3.0159, 3.0159}};
  for (int j = 0; j < 7; ++j) {
    const JointDescription& panda = kPanda.joints[j];
    EXPECT_GT(robot->limits.lower[j], std::max(panda.lower, kFr3[j][0])) << "J" << j + 1;
    EXPECT_LT(robot->limits.upper[j], std::min(panda.upper, kFr3[j][1])) << "J" << j + 1;
    EXPECT_LE(robot->limits.max_velocity[j], 2.175 / 2);
    EXPECT_LT(robot->limits.max_acceleration[j], 7.5);
  }
  EXPECT_EQ(robot->limits.upper[7], 0.08);
}

TEST(BridgeRobotFile, AModelNeedsAWorkspaceAndSaysWhatPresses) {
  const std::string model =
      "model: {file: seven.urdf, tool: tcp}\nworkspace: {table_z: 0.02, upper: [0.9, 0.9, 1.3], "
      "lower: [-0.9, -0.9, -0.1]}\n";
  const auto with = [](const std::string& text) { return SevenJoints() + text; };
  const auto robot = ParseBridgeRobot("arm.yaml", with(model));
  ASSERT_TRUE(robot.ok()) << robot.status();
  EXPECT_EQ(robot->workspace.table_z, 0.02);
  EXPECT_FALSE(robot->watches_torque()) << "the driver need not measure them";
  EXPECT_FALSE(robot->chain) << "parsing opens no file";
  EXPECT_THAT(Refused(with("model: {file: a.urdf, tool: tcp}")),
              HasSubstr("workspace is missing: with a model"));
  EXPECT_THAT(Refused(with("workspace: {table_z: 0}")), HasSubstr("workspace needs model"));
  EXPECT_THAT(Refused(with("model: {tool: tcp}\nworkspace: {}")), HasSubstr("model.file is empty"));
  EXPECT_THAT(Refused(with("model: {file: a.urdf}\nworkspace: {}")),
              HasSubstr("model.tool is empty"));
  EXPECT_THAT(Refused(with("model: {file: a.urdf, tool: t, radius: 2}\nworkspace: {}")),
              HasSubstr("model.radius is 2"));
  EXPECT_THAT(Refused(with("model: {file: a.urdf, tool: t, ignore: [J2-J9]}\nworkspace: {}")),
              HasSubstr("arm.yaml: model.ignore has 'J2-J9', must be two links"));
  EXPECT_THAT(Refused(with("model: {file: a.urdf, tool: t, joints: [a]}\nworkspace: {}")),
              HasSubstr("model.joints has 1 names, must have 7"));
  EXPECT_THAT(Refused(with("model: {file: a.urdf, tool: t}\nworkspace: {lower: [0, 0]}")),
              HasSubstr("arm.yaml: workspace.lower has 2 numbers"));
  EXPECT_THAT(Refused(with("model: {file: a.urdf, tool: t, root: b}\nworkspace: {}")),
              HasSubstr("root"));
  const std::string measures =
      absl::StrReplaceAll(with(model), {{"{torque_off: true}", "{measures_effort: true}"}});
  EXPECT_THAT(Refused(measures), HasSubstr("joints[0].press is 0, must be 0.01 to 100 Nm"));
  const std::string pressed =
      absl::StrReplaceAll(measures, {{"acceleration: 8}", "acceleration: 8, press: 3}"}});
  const auto watched = ParseBridgeRobot("arm.yaml", pressed);
  ASSERT_TRUE(watched.ok()) << watched.status();
  EXPECT_TRUE(watched->watches_torque());
  EXPECT_THAT(Refused(absl::StrReplaceAll(SevenJoints(),
                                          {{"acceleration: 8}", "acceleration: 8, press: 3}"}})),
              HasSubstr("joints[0].press is 3 Nm, and torques are watched with model"));
  EXPECT_THAT(Refused(absl::StrReplaceAll(SevenJoints(),
                                          {{"acceleration: 2}", "acceleration: 2, press: 3}"}})),
              HasSubstr("gripper.press"));
}

TEST(BridgeRobotFile, AModelIsReadFromTheFilesFolder) {
  const auto robot = LoadBridgeRobot("tests/robot_client/bridge/seven_modelled.yaml");
  ASSERT_TRUE(robot.ok()) << robot.status();
  ASSERT_TRUE(robot->chain);
  EXPECT_EQ(robot->chain->links.size(), 7u);
  EXPECT_EQ(robot->chain->file, "tests/robot_client/bridge/seven_joints.urdf");
  const std::string text = *ReadFile("tests/robot_client/bridge/seven_modelled.yaml");
  const std::string copy = ::testing::TempDir() + "/copy.yaml";
  ASSERT_TRUE(WriteFileAtomically(copy, text).ok());
  const absl::Status missing = LoadBridgeRobot(copy).status();
  EXPECT_EQ(missing.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(missing.message()), HasSubstr("seven_joints.urdf"));
}

// The configuration may say another table, margin and home than the file.
TEST(BridgeRobotFile, WhatIsWatchedIsChosenForTheWorkspaceInForce) {
  const auto chosen = [](const WorkspaceOptions& workspace, const std::vector<double>& home) {
    BridgeRobot robot = *LoadBridgeRobot("tests/robot_client/bridge/seven_modelled.yaml");
    EXPECT_TRUE(robot.chain->watched.empty()) << "not before";
    EXPECT_TRUE(ChooseWatched(workspace, home, robot).ok());
    return *robot.chain;
  };
  const BridgeRobot file = *LoadBridgeRobot("tests/robot_client/bridge/seven_modelled.yaml");
  WorkspaceOptions other = file.workspace;
  other.margin = 0.3;
  EXPECT_LT(chosen(other, file.home).watched.size(),
            chosen(file.workspace, file.home).watched.size());
  EXPECT_TRUE(chosen(file.workspace, file.home).below_table.empty());
  other = file.workspace;
  other.table_z = 0.32;
  EXPECT_EQ(chosen(other, file.home).below_table.size(), 1u);
  const std::vector<double> folded = {0, 0, 0, -3, 0, 0.6, 0, 0};
  EXPECT_LT(chosen(file.workspace, folded).watched.size(),
            chosen(file.workspace, file.home).watched.size());
  BridgeRobot without = *ParseBridgeRobot("arm.yaml", kFiveServos);
  EXPECT_TRUE(ChooseWatched({}, {}, without).ok()) << "no model";
}

TEST(BridgeRobotFile, RefusesADriverThatCountsInAnotherUnit) {
  const BridgeRobot robot = *LoadBridgeRobot("robot_client/bridge/so101.yaml");
  Welcome welcome;
  welcome.protocol = kVersion;
  welcome.axes = robot.names();
  welcome.hold = welcome.simulated = true;
  welcome.on_silence = OnSilence::kHold;
  welcome.watchdog_s = 0.25;
  welcome.units.resize(welcome.axes.size());
  EXPECT_EQ(Unfit(robot, welcome), "") << "a driver need not say it";
  for (size_t i = 0; i < robot.joints.size(); ++i) welcome.units[i].name = "degrees";
  welcome.units.back().range = {0, 100};
  EXPECT_EQ(Unfit(robot, welcome), "");
  welcome.units[4] = {"", {-100, 100}};  // LeRobot's use_degrees=false
  EXPECT_THAT(Unfit(robot, welcome),
              AllOf(HasSubstr("counts wrist_roll from -100 to 100, the robot file in degrees"),
                    HasSubstr("--robot.use_degrees=true")));
  welcome.units[4] = {"radians", {}};
  EXPECT_THAT(Unfit(robot, welcome), HasSubstr("wrist_roll in radians, the robot file in degrees"));
  welcome.units[4] = {"degrees", {}};
  welcome.units.back().range = {0, 1};
  EXPECT_THAT(Unfit(robot, welcome),
              HasSubstr("gripper from 0 to 1, the robot file in driver_range [0, 100]"));
  Welcome again = welcome;
  again.units[0].name = "radians";
  EXPECT_THAT(Differs(welcome, again), HasSubstr("another driver answers"));
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
