#include "common/joint_errors/scenario_file.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/joint_errors/effects/effect_library.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

constexpr char kWorn[] = R"(title: Worn elbow
base: isolated_stribeck
joints:
  - name: J4
    effects:
      - {type: transport_delay, delay_s: 0.02}
      - {type: compliance, K: 3000}
  - name: J2
    effects: [{type: cross_joint_coupling, k: -3, joint: J4}]
)";

// One effect at J1, as it stands in a file.
std::string Effect(const std::string& effect) {
  return absl::StrCat("joints: [{name: J1, effects: [{", effect, "}]}]\n");
}

TEST(ScenarioFile, HoldsEffectsPerJointBesideTheErrorsOfABuiltInScenario) {
  const auto file = ParseScenarioFile("worn.yaml", kWorn, kPanda);
  ASSERT_TRUE(file.ok()) << file.status();
  EXPECT_EQ(file->base, "isolated_stribeck");
  ASSERT_EQ(file->effects.size(), 3u);
  EXPECT_EQ(file->effects[0].joint, 3);
  EXPECT_EQ(file->effects[0].values, std::vector<double>{0.02});
  // What the library fixes need not be said.
  EXPECT_EQ(file->effects[1].values, (std::vector<double>{3000, 15, 0.7}));
  EXPECT_EQ(file->effects[2].joint, 1);
  EXPECT_EQ(file->effects[2].coupled, 3);
}

TEST(ScenarioFile, IsReadWhereverAScenarioIsNamed) {
  const std::string path =
      (fs::path(testing::TempDir()) / absl::StrCat("worn_elbow_", getpid(), ".yaml")).string();
  ASSERT_TRUE(WriteFileAtomically(path, kWorn).ok());
  const auto scenario = MakeScenario(path, 3);
  fs::remove(path);
  ASSERT_TRUE(scenario.ok()) << scenario.status();
  EXPECT_EQ(scenario->title, "Worn elbow");
  EXPECT_EQ(scenario->name, ScenarioLabel(path));
  EXPECT_TRUE(scenario->friction_on);
  EXPECT_FALSE(scenario->gravity_on);
  EXPECT_FALSE(scenario->deployment);
  EXPECT_EQ(scenario->effects.size(), 3u);
  EXPECT_EQ(scenario->end[0].friction, MakeScenario("isolated_stribeck", 3)->end[0].friction);
}

TEST(ScenarioFile, IsReadBackAsItWasWritten) {
  const auto file = ParseScenarioFile("worn.yaml", kWorn, kPanda);
  ASSERT_TRUE(file.ok());
  const std::string text = WriteScenarioFile(*file, kPanda);
  const auto again = ParseScenarioFile("again.yaml", text, kPanda);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(WriteScenarioFile(*again, kPanda), text);
}

TEST(ScenarioFile, MayHoldNoEffect) {
  for (const char* yaml : {"joints: []\n", "joints: [{name: J1, effects: []}]\n"}) {
    const auto file = ParseScenarioFile("x.yaml", yaml, kPanda);
    ASSERT_TRUE(file.ok()) << file.status();
    EXPECT_TRUE(file->effects.empty());
    EXPECT_EQ(file->base, "clean");
  }
}

TEST(ScenarioFile, NamesFileKeyValueAndWhatIsAllowed) {
  const struct {
    std::string yaml;
    std::vector<const char*> says;
  } cases[] = {
      {"joints: none\n", {"x.yaml: joints", "must be a list"}},
      {"title: Nothing\n", {"x.yaml: joints", "[] for a scenario without effects"}},
      {"joints: [{name: J1}]\n", {"joints[0].effects", "[] for a joint without effects"}},
      {"base: rainy\njoints: [{name: J1}]\n", {"base", "'rainy'", "clean"}},
      {"joints: [{name: J8, effects: []}]\n", {"joints[0].name", "'J8'", "J1 to J7"}},
      {Effect("type: rust"), {"joints[0].effects[0].type", "'rust'", "transport_delay"}},
      {Effect("type: deadzone, breadth: 1"), {"unknown key 'breadth'", "width"}},
      {Effect("type: deadzone"), {"effects[0].width", "is missing", "Nm"}},
      {Effect("type: deadzone, width: -1"), {"width", "is -1 Nm", "at least 0"}},
      {Effect("type: deadzone, width: wide"), {"width", "'wide'", "finite number"}},
      {Effect("type: transport_delay, delay_s: 3"), {"delay_s", "is 3 s", "at most 2"}},
      {Effect("type: torque_saturation, limit: 0"), {"limit", "is 0 Nm", "at least 0.8"}},
      {Effect("type: presliding_hysteresis, F: 1, x_s: 0"), {"x_s", "at least 3.14159e-06"}},
      {Effect("type: position_periodic_torque, a: 1, b: 0, wavelength: 1e-310"),
       {"wavelength", "is 1e-310 rad", "at least 3.14159e-06"}},
      {Effect("type: compliance, K: 1.7e308, frequency: 1, zeta: 2"),
       {"K", "is 1.7e+308 Nm/rad", "at most"}},
      {Effect("type: rate_limit, rate: 1"),
       {"effects[0].type", "position command of a servo [rad/s]", "Panda are given torques"}},
      {Effect("type: deadzone, width: 1, width: 2"),
       {"joints[0].effects[0]", "key 'width' is given twice; remove one"}},
      {"base: clean\nbase: nominal\njoints: []\n", {"the file", "key 'base' is given twice"}},
      {"joints: []\njoints: []\n", {"key 'joints' is given twice"}},
      {"joints: []\n---\njoints: []\n", {"x.yaml: a second document", "line 3"}},
      {"title: \"Worn\\nelbow\"\njoints: []\n", {"title", "'Worn elbow'", "line breaks"}},
      {Effect("type: cross_joint_coupling, k: 1"), {"effects[0].joint", "missing"}},
      {Effect("type: cross_joint_coupling, k: 1, joint: J1"), {"another joint"}},
      {"joints: [{name: J1, effects: [{type: deadzone, width: 1}, {type: deadzone, width: 2}]}]\n",
       {"'deadzone' stands twice at J1"}},
      {"joints: {\n", {"x.yaml: not YAML"}}};
  for (const auto& c : cases) {
    const auto file = ParseScenarioFile("x.yaml", c.yaml, kPanda);
    ASSERT_FALSE(file.ok()) << c.yaml;
    for (const char* words : c.says)
      EXPECT_THAT(std::string(file.status().message()), HasSubstr(words)) << c.yaml;
  }
}

TEST(ScenarioFile, MayEndWithAMarkThatNothingFollows) {
  EXPECT_TRUE(ParseScenarioFile("x.yaml", "---\njoints: []\n---\n", kPanda).ok());
}

TEST(ScenarioFile, MayNotBeCalledLikeABuiltInScenario) {
  const fs::path folder = fs::path(testing::TempDir()) / absl::StrCat("scenarios_", getpid());
  fs::create_directories(folder);
  const std::string path = (folder / "clean.yaml").string();
  ASSERT_TRUE(WriteFileAtomically(path, kWorn).ok());
  EXPECT_THAT(std::string(MakeScenario(path, 5).status().message()), HasSubstr("built in"));
  fs::remove_all(folder);
}

TEST(ScenarioFile, LetsEveryEffectOfTheLibraryStandAtEveryJointOfItsArm) {
  for (const RobotDescription& robot : {kPanda, kPiper}) {
    for (const EffectInfo& info : EffectLibrary()) {
      if (info.of_position) continue;  // the arms are given torques
      for (size_t joint = 0; joint < robot.joints.size(); ++joint) {
        ScenarioEffect effect{static_cast<int>(joint), info.type, {}};
        for (size_t i = 0; i < info.parameters.size(); ++i) {
          const EffectRange range = RangeInScenario(info, i, robot, effect.joint);
          EXPECT_LT(range.lower, range.upper) << info.type << " " << info.parameters[i].name;
          effect.values.push_back(range.upper > 1e9 ? 2 * range.lower : 0.9 * range.upper);
        }
        if (info.coupled) effect.coupled = joint == 0 ? 1 : 0;
        ScenarioFile alone;
        alone.effects = {effect};
        const auto file = ParseScenarioFile("x.yaml", WriteScenarioFile(alone, robot), robot);
        EXPECT_TRUE(file.ok()) << file.status();
      }
    }
  }
}

TEST(ScenarioFile, CouplesAJointToOneOther) {
  const auto status = [](const std::string& other) {
    return ParseScenarioFile(
               "x.yaml",
               "joints: [{name: J4, effects: [{type: cross_joint_coupling, k: 1, joint: "
               "J2}, {type: cross_joint_inertia, J: 0.1, joint: " +
                   other + "}]}]\n",
               kPanda)
        .status();
  };
  EXPECT_TRUE(status("J2").ok()) << status("J2");
  EXPECT_THAT(
      std::string(status("J3").message()),
      AllOf(HasSubstr("effects[1].joint: is J3, must be J2"), HasSubstr("one other joint")));
}

TEST(ScenarioFile, IsForOneArmWithItsJointsAndSizes) {
  const std::string seventh = "joints: [{name: J7, effects: [{type: deadzone, width: 1}]}]\n";
  EXPECT_TRUE(ParseScenarioFile("x.yaml", seventh, kPanda).ok());
  EXPECT_THAT(std::string(ParseScenarioFile("x.yaml", seventh, kPiper).status().message()),
              HasSubstr("joints[0].name: is 'J7', must be one of J1 to J6, the joints of a Piper"));
  // Of 8 Nm, where the Panda has 80.
  const std::string strong = "joints: [{name: J4, effects: [{type: deadzone, width: 20}]}]\n";
  EXPECT_TRUE(ParseScenarioFile("x.yaml", strong, kPanda).ok());
  EXPECT_THAT(std::string(ParseScenarioFile("x.yaml", strong, kPiper).status().message()),
              HasSubstr("width: is 20 Nm at J4, must be at least 0 and at most 8"));
  // An arm is what its description says, whatever it is called.
  RobotDescription named = kPiper;
  named.name = "panda_like";
  EXPECT_THAT(std::string(ParseScenarioFile("x.yaml", seventh, named).status().message()),
              HasSubstr("J1 to J6"));
}

}  // namespace
}  // namespace robostress
