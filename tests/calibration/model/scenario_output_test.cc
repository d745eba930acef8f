#include "calibration/model/scenario_output.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace robostress::calibration {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

RigJoint Joint(const std::string& name, JointInput input = JointInput::kTorque) {
  RigJoint joint;
  joint.name = name;
  joint.input = input;
  return joint;
}

// A pendulum whose declared friction stays, with a delay that was added, and a hinge beside it.
struct ScenarioOutputTest : public testing::Test {
  ScenarioOutputTest() {
    declared.name = "bench";
    declared.joints = {Joint("hinge"), Joint("wrist")};
    declared.joints[0].effects = {{.type = "deadzone", .parameters = {{"width", 0.1}}}};
    after = declared;
  }
  void Add(int joint, const std::string& type, std::map<std::string, double> parameters) {
    after.joints[joint].effects.push_back({.type = type, .parameters = std::move(parameters)});
  }
  absl::StatusOr<ScenarioOutput> Make(const std::vector<std::string>& map) const {
    const auto parsed = ParseJointMap(map, declared, kPanda);
    if (!parsed.ok()) return parsed.status();
    return ScenarioOfRig(declared, after, *parsed, "Bench", kPanda);
  }
  Rig declared, after;
};

TEST_F(ScenarioOutputTest, CarriesWhatWasAddedAndNothingThatWasDeclared) {
  Add(0, "transport_delay", {{"delay_s", 0.02}});
  const auto output = Make({"hinge=J4"});
  ASSERT_TRUE(output.ok()) << output.status();
  ASSERT_EQ(output->scenario.effects.size(), 1u);
  EXPECT_EQ(output->scenario.effects[0].type, "transport_delay");
  EXPECT_EQ(output->scenario.effects[0].joint, 3);
  EXPECT_THAT(output->scenario.effects[0].values, ElementsAre(0.02));
  EXPECT_EQ(output->scenario.base, "clean");
}

TEST_F(ScenarioOutputTest, KeepsPhysicalValuesUnlessARatioScalesTorques) {
  Add(0, "presliding_hysteresis", {{"F", 0.4}, {"x_s", 0.01}});
  const auto kept = Make({"hinge=J4+J2"});
  ASSERT_TRUE(kept.ok()) << kept.status();
  ASSERT_EQ(kept->scenario.effects.size(), 2u);
  EXPECT_THAT(kept->scenario.effects[1].values, ElementsAre(0.4, 0.01));
  const auto scaled = Make({"hinge=J4:2.5"});
  ASSERT_TRUE(scaled.ok()) << scaled.status();
  EXPECT_THAT(scaled->scenario.effects[0].values, ElementsAre(1.0, 0.01));
}

TEST_F(ScenarioOutputTest, SaysWhatItLeavesOut) {
  Add(0, "transport_delay", {{"delay_s", 0.02}});
  Add(1, "deadzone", {{"width", 0.2}});
  const auto output = Make({"hinge=J4"});
  ASSERT_TRUE(output.ok()) << output.status();
  EXPECT_THAT(output->notes, ElementsAre(HasSubstr("wrist: deadzone is left out")));
}

TEST_F(ScenarioOutputTest, HasNoRateLimit) {
  Add(0, "rate_limit", {{"rate", 1.0}});
  const auto message = [&] { return std::string(Make({"hinge=J4"}).status().message()); };
  EXPECT_THAT(message(), HasSubstr("torque command's rate"));
  declared.joints[0].input = after.joints[0].input = JointInput::kPositionTarget;
  EXPECT_THAT(message(), HasSubstr("it limits a position command"));
  EXPECT_EQ(Make({"hinge=J4"}).status().code(), absl::StatusCode::kFailedPrecondition);
}

TEST_F(ScenarioOutputTest, CarriesACouplingWithItsPartner) {
  after.joints[1].effects.push_back(
      {.type = "cross_joint_coupling", .parameters = {{"k", 2}}, .partner = "hinge"});
  const auto output = Make({"wrist=J5,hinge=J2"});
  ASSERT_TRUE(output.ok()) << output.status();
  EXPECT_EQ(output->scenario.effects[0].coupled, 1);
  const auto alone = Make({"wrist=J5"});
  EXPECT_THAT(std::string(alone.status().message()), HasSubstr("coupled to"));
}

TEST_F(ScenarioOutputTest, LeavesOutWhatTheArmsJointCannotBeGivenAndSaysSo) {
  Add(0, "stribeck_friction", {{"Fc", 900}, {"Fs", 950}, {"vs", 0.1}, {"sigma_v", 1}});
  const auto alone = Make({"hinge=J7"});
  EXPECT_EQ(alone.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(alone.status().message()), HasSubstr("torque ratio"));
  Add(0, "backlash", {{"B", 0.01}});
  const auto output = Make({"hinge=J7"});
  ASSERT_TRUE(output.ok()) << output.status();
  EXPECT_EQ(output->scenario.effects.size(), 1u);
  EXPECT_THAT(output->notes, testing::ElementsAre(HasSubstr("torque ratio")));
}

TEST_F(ScenarioOutputTest, WritesALengthOfZeroAsTheLeastThatAScenarioHolds) {
  Add(0, "presliding_hysteresis", {{"F", 3.4}, {"x_s", 0}});
  const auto output = Make({"hinge=J1+J7"});
  ASSERT_TRUE(output.ok()) << output.status();
  ASSERT_EQ(output->scenario.effects.size(), 2u);
  for (const ScenarioEffect& effect : output->scenario.effects)
    EXPECT_THAT(effect.values, ElementsAre(3.4, testing::DoubleNear(3.14159e-6, 1e-10)));
  EXPECT_THAT(output->notes, ElementsAre(HasSubstr("x_s is written as 3.14e-06 rad")));
}

TEST_F(ScenarioOutputTest, IsAbsentWhereNothingWasAdded) {
  EXPECT_EQ(Make({"hinge=J1"}).status().code(), absl::StatusCode::kFailedPrecondition);
}

TEST_F(ScenarioOutputTest, MapsTheArmsOwnJointsByName) {
  declared.joints = {Joint("robot0_joint4"), Joint("J2"), Joint("joint7"), Joint("gripper")};
  const auto map = ParseJointMap({"own"}, declared, kPanda);
  ASSERT_TRUE(map.ok()) << map.status();
  EXPECT_EQ(map->size(), 3u);
  EXPECT_THAT(map->at("robot0_joint4").arm_joints, ElementsAre(3));
  EXPECT_THAT(map->at("J2").arm_joints, ElementsAre(1));
  EXPECT_THAT(map->at("joint7").arm_joints, ElementsAre(6));
}

TEST_F(ScenarioOutputTest, NamesTheRigsJointsInErrors) {
  for (const char* bad : {"hinge", "elbow=J4", "hinge=J8", "hinge=J4:0", "hinge=J1,hinge=J2"}) {
    const auto map = ParseJointMap({bad}, declared, kPanda);
    ASSERT_FALSE(map.ok()) << bad;
    EXPECT_THAT(std::string(map.status().message()), HasSubstr("hinge, wrist")) << bad;
  }
}

}  // namespace
}  // namespace robostress::calibration
