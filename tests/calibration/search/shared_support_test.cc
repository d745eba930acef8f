#include "calibration/search/shared_support.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace robostress::calibration {
namespace {

using testing::HasSubstr;

// Without, with, change, floor.
OtherJoint Joint(const std::string& name, double without, double with, double change) {
  return {name, without, with, change, 1, false};
}

TEST(SharedSupport, IsOfAJointThatIsPredictedBetter) {
  EXPECT_EQ(ObjectionOf("payload", {Joint("J1", 5, 4.8, 3)}), "");
  EXPECT_EQ(ObjectionOf("payload", {Joint("J1", 5, 4.8, 3), Joint("J2", 1, 1, 0.1)}), "");
  EXPECT_THAT(ObjectionOf("payload", {Joint("J1", 5, 4.95, 3)}), HasSubstr("J1 does without it"));
}

TEST(SharedSupport, IsNotGivenByJointsThatCanNotSeeIt) {
  EXPECT_THAT(ObjectionOf("base_tilt", {Joint("J1", 5, 4, 1.9)}),
              HasSubstr("no other joint shows whether it is there"));
  EXPECT_THAT(ObjectionOf("base_tilt", {}), HasSubstr("no other joint shows"));
}

TEST(SharedSupport, IsTakenBackByOneThatIsPredictedWorse) {
  const std::vector<OtherJoint> others = {Joint("J1", 5, 4, 3), Joint("J2", 5, 5.3, 3)};
  EXPECT_THAT(ObjectionOf("base_tilt", others), HasSubstr("J2 is predicted worse with it, 5.3"));
  EXPECT_EQ(ObjectionOf("base_tilt", {Joint("J1", 5, 4, 3), Joint("J2", 1, 1.9, 3)}), "");
}

TEST(SharedSupport, IsOfAJointThatFoundTheSameByItself) {
  OtherJoint faint = Joint("J1", 1.1, 1, 1.9);
  faint.agrees = true;
  EXPECT_EQ(ObjectionOf("base_tilt", {faint}), "");
  EXPECT_THAT(ObjectionOf("base_tilt", {faint, Joint("J2", 5, 5.3, 3)}), HasSubstr("worse"));
}

TEST(SharedSupport, FindingsAgreeByTenPercentOrByTheirErrors) {
  const auto tilt = [](double y, double std) {
    AddedEffectReport effect;
    effect.type = "base_tilt";
    effect.parameters.resize(1);
    effect.parameters[0].name = "y";
    effect.parameters[0].value = y;
    effect.parameters[0].std = std;
    return effect;
  };
  EXPECT_TRUE(Agree(tilt(0.0100, 1e-5), tilt(0.0091, 1e-5)));
  EXPECT_FALSE(Agree(tilt(0.0100, 1e-5), tilt(0.0089, 1e-5)));
  EXPECT_TRUE(Agree(tilt(0.0100, 3e-4), tilt(0.0087, 4e-4))) << "within 3 of their errors, 1.5e-3";
  EXPECT_FALSE(Agree(tilt(0.0100, 1e-5), tilt(-0.0100, 1e-5)));
  AddedEffectReport other = tilt(0.01, 1e-5);
  other.type = "payload";
  EXPECT_FALSE(Agree(tilt(0.01, 1e-5), other));
  other = tilt(0.01, 1e-5);
  other.parameters[0].name = "x";
  EXPECT_FALSE(Agree(tilt(0.01, 1e-5), other)) << "nothing that both fitted";
}

TEST(SharedSupport, IsAskedForBesideWhatElseJointsLack) {
  Rig rig;
  rig.joints.resize(2);
  rig.joints[0].effects = {{.type = "stribeck_friction", .parameters = {{"Fc", 1}}}};
  Rig after = rig;
  after.joints[0].effects[0].parameters["Fc"] = 2;
  after.joints[0].effects.push_back({.type = "gravity_error", .parameters = {{"beta", 0.1}}});
  for (RigJoint& joint : after.joints)
    joint.effects.push_back({.type = "base_tilt", .parameters = {{"y", 0.02}}});
  const Rig asked = WithOtherFindings(rig, after, "base_tilt");
  ASSERT_EQ(asked.joints[0].effects.size(), 2U);
  EXPECT_EQ(asked.joints[0].effects[0].parameters.at("Fc"), 1) << "still the rig's, to be fitted";
  EXPECT_EQ(asked.joints[0].effects[1].type, "gravity_error");
  EXPECT_TRUE(asked.joints[1].effects.empty());
}

TEST(SharedSupport, IsAskedForWhatActsOnTheWholeArm) {
  EXPECT_TRUE(ActsOnTheWholeArm("payload"));
  EXPECT_TRUE(ActsOnTheWholeArm("base_tilt"));
  EXPECT_FALSE(ActsOnTheWholeArm("gravity_error"));
}

}  // namespace
}  // namespace robostress::calibration
