#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "calibration/data/rig.h"
#include "calibration/model/joint_model.h"
#include "calibration/model/plant.h"
#include "common/atomic_file.h"

namespace robostress::calibration {
namespace {

using testing::AllOf;
using testing::HasSubstr;

class RigGates : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = testing::TempDir() + "/rig_gates";
    ASSERT_TRUE(MakeDirectories(folder_).ok());
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  absl::StatusOr<Rig> Read(const std::string& text) {
    EXPECT_TRUE(WriteFileAtomically(folder_ + "/rig.yaml", text).ok());
    return ReadRig(folder_ + "/rig.yaml");
  }
  static std::string Text(const std::string& joint, const std::string& log) {
    return absl::StrCat("name: a\nmodel: m.xml\nrate_hz: 200\njoints:\n  - {", joint,
                        "}\nlogs:\n  - {", log, "}\n");
  }
  static constexpr const char* kJoint = "name: hinge, input: position_target, servo: {kp: 10}";
  std::string folder_;
};

TEST_F(RigGates, WhatIsWrittenReadsBackTheSame) {
  const auto rig =
      Read(Text("name: hinge, input: position_target, servo: {kp: 10, kd: 1, torque_limit: 3, "
                "feedback: motor}, velocity: motor, "
                "enable: on_hinge, fit: [armature], effects: [{type: backlash, B: 0.01, fit: [B]}]",
                "file: log.csv, role: fit, condition: warm, overrides: {hinge.servo.kp: 20}"));
  ASSERT_TRUE(rig.ok()) << rig.status();
  const auto again = Read(WriteRig(*rig));
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(WriteRig(*again), WriteRig(*rig));
  EXPECT_EQ(again->joints[0].enable, "on_hinge");
  EXPECT_EQ(again->joints[0].servo.torque_limit, 3);
  EXPECT_EQ(again->joints[0].velocity, VelocitySide::kMotor);
  EXPECT_EQ(again->joints[0].effects[0].parameters.at("B"), 0.01);
  EXPECT_EQ(again->logs[0].overrides.at("hinge.servo.kp"), 20);
}

TEST_F(RigGates, RefusesWhatItDoesNotKnowAndSaysWhatItDoes) {
  const auto message = [&](const std::string& joint, const std::string& log) {
    return std::string(Read(Text(joint, log)).status().message());
  };
  EXPECT_THAT(
      message("name: hinge, input: torques", "file: a.csv"),
      AllOf(HasSubstr("joints[0].input"), HasSubstr("'torques'"), HasSubstr("transmission")));
  EXPECT_THAT(message("name: hinge, input: torque, velocity: link", "file: a.csv"),
              AllOf(HasSubstr("joints[0].velocity"), HasSubstr("'link'"), HasSubstr("motor")));
  EXPECT_THAT(message("name: hinge, input: torque, fits: [armature]", "file: a.csv"),
              AllOf(HasSubstr("unknown key 'fits'"), HasSubstr("fit")));
  EXPECT_THAT(message("name: hinge, input: torque, fit: [weight]", "file: a.csv"),
              AllOf(HasSubstr("'weight'"), HasSubstr("mass_scale")));
  EXPECT_THAT(message("name: hinge, input: torque, effects: [{type: rust}]", "file: a.csv"),
              AllOf(HasSubstr("'rust'"), HasSubstr("stribeck_friction")));
  EXPECT_THAT(message("name: hinge, input: position_target", "file: a.csv"), HasSubstr("servo"));
  EXPECT_THAT(message(kJoint, "file: a.csv, role: test"), HasSubstr("held_out"));
  EXPECT_THAT(message(kJoint, "file: a.csv, role: held_out"), HasSubstr("no log has role fit"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {elbow.servo.kp: 3}"), HasSubstr("elbow"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {hinge.known_mass: -1}"),
              HasSubstr("hinge.known_mass: is -1, must be at least 0"));
  EXPECT_THAT(message("name: hinge, input: position_target, servo: {kp: .nan}", "file: a.csv"),
              HasSubstr("finite"));
  EXPECT_THAT(message("name: hinge, name: elbow, input: torque", "file: a.csv"),
              HasSubstr("joints[0]: key 'name' is given twice; remove one"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {hinge.damping: 1, hinge.damping: 2}"),
              HasSubstr("overrides: key 'hinge.damping' is given twice"));
  EXPECT_THAT(std::string(Read("name: a\n---\nname: b\n").status().message()),
              HasSubstr("a second document begins before line 3"));
  EXPECT_THAT(std::string(Read("name: [").status().message()), HasSubstr("not YAML"));
}

TEST_F(RigGates, RefusesKeysThatStandTwice) {
  const auto message = [&](const std::string& joint, const std::string& log) {
    return std::string(Read(Text(joint, log)).status().message());
  };
  EXPECT_THAT(
      message("name: hinge, input: position_target, servo: {kp: 20, kp: 2000}", "file: a.csv"),
      HasSubstr("joints[0].servo: key 'kp' is given twice; remove one"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {hinge.damping: 1, hinge.damping: 2}"),
              HasSubstr("logs[0].overrides: key 'hinge.damping' is given twice"));
  EXPECT_THAT(message("name: hinge, input: torque, fit: [damping, damping]", "file: a.csv"),
              HasSubstr("joints[0].fit[1]: is 'damping' again; leave one"));
  const auto metrics =
      Read(Text(kJoint, "file: a.csv") + "metric: {unit: m}\nmetric: {unit: rad}\n");
  EXPECT_THAT(std::string(metrics.status().message()),
              HasSubstr("rig.yaml: key 'metric' is given twice"));
}

TEST_F(RigGates, RefusesValuesThatNoMachineHas) {
  const auto of_joint = [&](const std::string& text) {
    return std::string(Read(Text(absl::StrCat("name: hinge, input: torque, ", text), "file: a.csv"))
                           .status()
                           .message());
  };
  EXPECT_THAT(of_joint("parameters: {damping: -5}"),
              HasSubstr("joints[0].parameters.damping: is -5, must be at least 0"));
  EXPECT_THAT(of_joint("parameters: {frictionloss: -0.2}"), HasSubstr("must be at least 0"));
  EXPECT_THAT(of_joint("parameters: {mass_scale: 0}"), HasSubstr("is 0, must be above 0"));
  EXPECT_THAT(of_joint("servo: {kp: 1, torque_limit: 0}"),
              HasSubstr("joints[0].servo.torque_limit: is 0, must be above 0"));
  EXPECT_THAT(of_joint("effects: [{type: stribeck_friction, Fc: -1}]"),
              HasSubstr("joints[0].effects[0].Fc: is -1, must be at least 0"));
  EXPECT_EQ(of_joint("parameters: {damping: 0, torque_offset: -1}"), "");
  EXPECT_EQ(of_joint("effects: [{type: encoder_offset, offset: -1}]"), "");
  const auto of_log = [&](const std::string& overrides) {
    return std::string(Read(Text(kJoint, absl::StrCat("file: a.csv, overrides: {", overrides, "}")))
                           .status()
                           .message());
  };
  EXPECT_THAT(of_log("hinge.servo.kp: -20"),
              HasSubstr("logs[0].overrides.hinge.servo.kp: is -20, must be above 0"));
  EXPECT_THAT(of_log("hinge.backlash.B: -1"), HasSubstr("is -1, must be at least 0"));
}

TEST_F(RigGates, RefusesALogThatIsFittedAndHeldOutUnderTwoNames) {
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/a.csv", "t\n1\n").ok());
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/copy.csv", "t\n1\n").ok());
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/other.csv", "t\n2\n").ok());
  const auto with = [&](const std::string& file) {
    return Read(Text(kJoint, "file: a.csv") + "  - {file: " + file + ", role: held_out}\n");
  };
  for (const char* same : {"a.csv", "./a.csv", "../rig_gates/a.csv", "copy.csv"})
    EXPECT_THAT(std::string(with(same).status().message()),
                AllOf(HasSubstr("logs[1]: file '"), HasSubstr("is or copies '"),
                      HasSubstr("a.csv' of logs[0]; leave one")))
        << same;
  EXPECT_TRUE(with("other.csv").ok());
}

TEST_F(RigGates, RefusesAMetricOfWhatTheInputDoesNotCompare) {
  const auto message = [&](const std::string& input, const std::string& metric) {
    const std::string joint = "name: hinge, servo: {kp: 10}, input: " + input;
    return std::string(
        Read(Text(joint, "file: a.csv") + "metric: {type: " + metric + "}\n").status().message());
  };
  EXPECT_THAT(message("position_target", "torque_rmse"),
              HasSubstr("metric.type: is 'torque_rmse', and input position_target of joint 'hinge' "
                        "compares positions: position_rmse, position_mae"));
  EXPECT_THAT(message("inverse", "position_mae"), HasSubstr("compares torques: torque_rmse"));
  const auto rig =
      Read(Text("name: hinge, input: inverse", "file: a.csv") + "metric: {type: torque_mae}\n");
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_THAT(WriteRig(*rig), HasSubstr("torque_mae"));
}

TEST_F(RigGates, ExpandsEnvironmentVariablesInFileNames) {
  ASSERT_EQ(setenv("RIG_GATES_DATA", "/data/runs", 1), 0);
  const auto rig = Read(Text(kJoint, "file: \"${RIG_GATES_DATA}/log.csv\""));
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_EQ(rig->logs[0].file, "/data/runs/log.csv");
  ASSERT_EQ(unsetenv("RIG_GATES_DATA"), 0);
  EXPECT_THAT(
      std::string(Read(Text(kJoint, "file: \"${RIG_GATES_DATA}/log.csv\"")).status().message()),
      AllOf(HasSubstr("logs[0].file"), HasSubstr("RIG_GATES_DATA is not set")));
}

TEST_F(RigGates, RefusesAModelThatIsAbsentOrDoesNotLoadOrLacksTheJoint) {
  auto rig = Read(Text(kJoint, "file: a.csv"));
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()),
              AllOf(HasSubstr("m.xml"), HasSubstr("no such file")));
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/m.xml", "<mujoco><worldbody>").ok());
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()), HasSubstr("does not load"));
  ASSERT_TRUE(
      WriteFileAtomically(folder_ + "/m.xml",
                          "<mujoco><worldbody><body><joint name=\"knee\"/><geom size=\"1\"/>"
                          "</body></worldbody></mujoco>")
          .ok());
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()),
              AllOf(HasSubstr("no joint 'hinge'"), HasSubstr("knee")));
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/m.xml",
                                  "<mujoco><worldbody><body><freejoint name=\"hinge\"/>"
                                  "<geom size=\"1\"/></body></worldbody></mujoco>")
                  .ok());
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()), HasSubstr("ball or free"));
}

TEST_F(RigGates, RefusesAJointThatIsCoupledToTwoOthersOrToItself) {
  std::string mjcf = "<mujoco><worldbody>";
  for (const char* name : {"a", "b", "hinge"})
    absl::StrAppend(&mjcf, "<body><joint name=\"", name, "\"/><geom size=\"1\"/></body>");
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/m.xml", mjcf + "</worldbody></mujoco>").ok());
  const auto message = [&](const std::string& one, const std::string& other) {
    const auto rig = Read(absl::StrCat(
        "name: a\nmodel: m.xml\nrate_hz: 200\njoints:\n  - {name: a, input: torque}\n  - {name: b, "
        "input: torque}\n  - {name: hinge, input: torque, effects: [{type: cross_joint_coupling, "
        "k: 1, "
        "partner: ",
        one, "}, {type: cross_joint_inertia, J: 1, partner: ", other,
        "}]}\nlogs:\n  - {file: a.csv}\n"));
    EXPECT_TRUE(rig.ok()) << rig.status();
    const auto plant = Plant::Load(*rig);
    EXPECT_TRUE(plant.ok()) << plant.status();
    return std::string(DeclaredModel(*rig, **plant, 2).status().message());
  };
  EXPECT_EQ(message("a", "a"), "");
  EXPECT_THAT(message("a", "b"), AllOf(HasSubstr("joint 'hinge'"), HasSubstr("must be a"),
                                       HasSubstr("one other joint")));
  EXPECT_THAT(message("hinge", "hinge"), HasSubstr("must be another joint"));
}

}  // namespace
}  // namespace robostress::calibration
