#include "server/proxy/arm_profile.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "tests/server/proxy/proxy_messages.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr char kPanda[] = R"(name: panda
control_space: end_effector
dialect: libero
rate_hz: 20
execute_steps: 5
state: {position: [0, 1, 2], rotation: [3, 4, 5]}
action: {size: 7, translation: [0, 1, 2], rotation: [3, 4, 5], translation_unit: 0.05, rotation_unit: 0.5}
limits: {correction: [0.4], rate: [2]}
)";

absl::StatusOr<ArmProfile> Load(const std::string& text) {
  const std::string file = absl::StrCat(::testing::TempDir(), "/robot-", getpid(), ".yaml");
  std::ofstream(file) << text;
  auto profile = LoadArmProfile(file);
  std::filesystem::remove(file);
  return profile;
}

std::string Complaint(const std::string& from, const std::string& to) {
  const std::string text = absl::StrReplaceAll(kPanda, {{from, to}});
  EXPECT_NE(text, kPanda) << from;
  const auto profile = Load(text);
  EXPECT_FALSE(profile.ok()) << to;
  return std::string(profile.status().message());
}

TEST(ArmProfile, SaysWhatAColumnIsInAMethodsNumbers) {
  const auto profile = Load(kPanda);
  ASSERT_TRUE(profile.ok()) << profile.status();
  EXPECT_EQ(profile->columns(), (std::vector<int>{0, 1, 2, 3, 4, 5}));
  EXPECT_EQ(profile->axes().back(), "yaw");
  EXPECT_EQ(profile->scale(), Eigen::VectorXd::Ones(6));
  EXPECT_EQ(profile->correction_limit(), Eigen::VectorXd::Constant(6, 0.4));
  EXPECT_TRUE(profile->step_limit().isApprox(Eigen::VectorXd::Constant(6, 0.1)));
  EXPECT_EQ(profile->keys.state, std::vector<std::string>{"observation/state"});
  // Commands in metres and radians, of which a full step is 0.05 and 0.5.
  ArmProfile metric = *profile;
  metric.action.translation_unit = metric.action.rotation_unit = 1;
  metric.action.translation_full = 0.05;
  metric.action.rotation_full = 0.5;
  metric.limits.correction = {0.02, 0.02, 0.02, 0.1, 0.1, 0.1};
  EXPECT_TRUE(CheckArmProfile(metric).ok()) << CheckArmProfile(metric);
  EXPECT_DOUBLE_EQ(metric.scale()[0], 20);
  EXPECT_DOUBLE_EQ(metric.correction_limit()[0], 0.4);
  EXPECT_DOUBLE_EQ(metric.correction_limit()[5], 0.2);
}

TEST(ArmProfile, RefusesASpaceThatItDoesNotUnderstand) {
  EXPECT_THAT(Complaint("end_effector", "joint_velocity"),
              AllOf(HasSubstr("control_space is 'joint_velocity'"),
                    HasSubstr("end_effector (deltas of the tool)"), HasSubstr("absolute targets"),
                    HasSubstr("connect the client directly")));
  EXPECT_THAT(Complaint("control_space: end_effector\n", ""), HasSubstr("control_space is ''"));
}

TEST(ArmProfile, NamesFieldValueAndLimitOfWhatIsWrong) {
  EXPECT_THAT(Complaint("rate_hz: 20", "rate_hz: 0"), HasSubstr("rate_hz is 0, must be 0.1..1000"));
  EXPECT_THAT(Complaint("execute_steps: 5\n", ""), HasSubstr("execute_steps is 0, must be 1.."));
  EXPECT_THAT(Complaint("rate_hz: 20\n", "rate_hz: 20\nasynchronous: true\nfirst_step: 1\n"),
              HasSubstr("set first_step to 0 and real_time to true"));
  EXPECT_THAT(Complaint("[0, 1, 2], rotation: [3, 4, 5]}", "[0, 1], rotation: [3, 4, 5]}"),
              HasSubstr("state.position names 2 indices, must name 3"));
  EXPECT_THAT(Complaint("translation: [0, 1, 2]", "translation: [0, 1, 7]"),
              HasSubstr("action.translation names index 7, must be 0..6"));
  EXPECT_THAT(Complaint("translation: [0, 1, 2]", "translation: [0, 1, 3]"),
              HasSubstr("action.rotation names index 3, which stands for something else"));
  EXPECT_THAT(Complaint("correction: [0.4]", "correction: [1.5]"),
              HasSubstr("limits.correction of x is 1.5, must be at most 1, a full step"));
  EXPECT_THAT(Complaint("correction: [0.4]", "correction: [0.4, 0.4]"),
              HasSubstr("limits.correction has 2 values, must have one, or one for each of 6"));
  EXPECT_THAT(Complaint("rate: [2]", "rate: [0]"), HasSubstr("the correction would never begin"));
  EXPECT_THAT(Complaint("rate: [2]", "rate: [-2]"), HasSubstr("limits.rate holds -2"));
  EXPECT_THAT(Complaint("translation_unit: 0.05", "low: [-1], high: [1]"),
              HasSubstr("both must have 7, or none"));
  EXPECT_THAT(Complaint("translation_unit: 0.05", "translation_full: 1e-300"),
              HasSubstr("action.translation_full is 1e-300, must be 0.0001..1"));
  // Valid types, absurd values.
  for (const auto& [from, to] : std::vector<std::pair<std::string, std::string>>{
           {"rate_hz: 20", "rate_hz: -20"},
           {"rate_hz: 20", "rate_hz: .nan"},
           {"rate_hz: 20", "rate_hz: 1e300"},
           {"execute_steps: 5", "execute_steps: -5"},
           {"execute_steps: 5", "execute_steps: 1025"},
           {"execute_steps: 5", "execute_steps: 99999999999"},
           {"execute_steps: 5", "first_step: -1\nexecute_steps: 5"},
           {"rotation: [3, 4, 5]}", "rotation: [3, 4, 4]}"},
           {"rotation: [3, 4, 5], trans", "rotation: [3, 4, -1], trans"},
           {"size: 7", "size: 0"},
           {"size: 7", "size: 1000000"},
           {"translation_unit: 0.05", "translation_unit: 1e300"},
           {"translation_unit: 0.05", "translation_unit: -0.05"},
           {"translation_unit: 0.05", "translation_full: 1e-300"},
           {"rotation_unit: 0.5", "rotation_full: .nan"},
           {"limits:", "nominal: {stiffness: 1e300}\nlimits:"},
           {"limits:", "nominal: {stiffness: -150}\nlimits:"},
           {"limits:", "nominal: {damping_ratio: .inf}\nlimits:"},
           {"limits:", "nominal: {sub_steps: 0}\nlimits:"},
           {"limits:", "observer_bandwidth: 0\nlimits:"},
           {"correction: [0.4]", "correction: [.nan]"},
           {"correction: [0.4]", "correction: [-0.4]"},
           {"rate: [2]", "rate: [1e300]"},
           {"rate: [2]", "rate: [2], jump_m: -1"},
           {"rate: [2]", "rate: [2], jump_rad: .inf"},
           {"rate: [2]", "rate: [2], pause_s: .nan"},
           {"translation_unit: 0.05",
            "low: [.nan, 0, 0, 0, 0, 0, 0], high: [1, 1, 1, 1, 1, 1, 1]"}})
    EXPECT_THAT(Complaint(from, to), HasSubstr("robot-")) << to;
  EXPECT_THAT(Complaint("dialect: libero", "dialect: klingon"),
              AllOf(HasSubstr("no dialect 'klingon'"), HasSubstr("libero")));
  EXPECT_THAT(Complaint("rate_hz", "rate_hertz"), HasSubstr("rate_hertz"));
  EXPECT_THAT(Complaint("rotation_unit: 0.5", "joints: [6]"),
              HasSubstr("belong to control_space joint"));
}

TEST(ArmProfile, AJointHasANameOfItsOwn) {
  ArmProfile profile = JointProfile(2);
  profile.joint_names = {"hinge", "elbow"};
  EXPECT_TRUE(CheckArmProfile(profile).ok());
  profile.joint_names = {"hinge", "hinge"};
  EXPECT_THAT(std::string(CheckArmProfile(profile).message()),
              HasSubstr("joint_names names 'hinge' twice"));
}

TEST(ArmProfile, TakesTheExamplesOfItsPage) {
  std::ifstream file("docs/results/proxy.md");
  const std::string page((std::istreambuf_iterator<char>(file)), {});
  int found = 0;
  for (size_t at = 0; (at = page.find("```yaml\n", at)) != std::string::npos;) {
    at += 8;
    const std::string block = page.substr(at, page.find("```", at) - at);
    if (block.find("control_space: ") == std::string::npos) continue;  // calibrate's
    ++found;
    const auto profile = Load(block);
    ASSERT_TRUE(profile.ok()) << profile.status();
    EXPECT_TRUE(MethodOf(*profile).ok()) << MethodOf(*profile).status();
  }
  EXPECT_EQ(found, 3);
}

TEST(ArmProfile, TakesTheMethodsThatItsSpaceAllows) {
  ArmProfile profile = LiberoProfile();
  const auto method = MethodOf(profile);
  ASSERT_TRUE(method.ok()) << method.status();
  EXPECT_NEAR(method->tracking_gain, 0.267, 1e-3) << "the nominal arm's own";
  profile.nominal.goal_reference = GoalReference::kDesired;
  EXPECT_NEAR(MethodOf(profile)->tracking_gain, 1, 1e-3);
  EXPECT_EQ(MethodOf(profile, {"tracking_gain=0.5"})->tracking_gain, 0.5);
  const auto complaint = [&profile](const char* name) {
    profile.method = name;
    const auto refused = MethodOf(profile);
    return refused.ok() ? std::string("fine") : std::string(refused.status().message());
  };
  for (const char* name : {"base", "gain", "direct", "ours_integral", "ours_following"})
    EXPECT_EQ(complaint(name), "fine") << name;
  EXPECT_THAT(complaint("ours"), HasSubstr("adapts weights"));
  EXPECT_THAT(complaint("dob"), HasSubstr("observes joints"));
  EXPECT_THAT(complaint("null"), HasSubstr("sampling noise"));
  EXPECT_THAT(complaint("blank_images"), HasSubstr("what the policy sees"));
  profile = JointProfile(7);
  for (const char* name : {"base", "direct", "dob"}) EXPECT_EQ(complaint(name), "fine") << name;
  EXPECT_THAT(complaint("ours_following"), HasSubstr("in the proxy: method dob"));
  EXPECT_THAT(complaint("gain"), HasSubstr("absolute joint targets"));
}

}  // namespace
}  // namespace robostress
