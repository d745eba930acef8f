#include "common/config.h"

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/unit_config.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string Message(const absl::Status& status) { return std::string(status.message()); }

TEST(Config, DefaultsStandForAbsentKeys) {
  const auto unit = ParseConfig<UnitConfig>(
      "u.yaml", "suite: tabletop_goal\nsim:\n  joint_errors: {friction_law: stick}\n");
  ASSERT_TRUE(unit.ok()) << unit.status();
  EXPECT_EQ(unit->suite, "tabletop_goal");
  EXPECT_EQ(unit->sim.joint_errors.friction_law, FrictionLaw::kStick);
  EXPECT_EQ(unit->episodes, 20);
}

TEST(Config, EmptyTextIsAllDefaults) { EXPECT_TRUE(ParseConfig<UnitConfig>("u.yaml", "").ok()); }

TEST(Config, UnknownKeyIsNamedWithItsPathAndTheKnownOnes) {
  const auto unit =
      ParseConfig<UnitConfig>("u.yaml", "sim:\n  joint_errors:\n    friction_laws: sgn\n");
  ASSERT_FALSE(unit.ok());
  EXPECT_THAT(Message(unit.status()), HasSubstr("u.yaml"));
  EXPECT_THAT(Message(unit.status()), HasSubstr("sim.joint_errors.friction_laws"));
  EXPECT_THAT(Message(unit.status()), HasSubstr("friction_law,"));
}

TEST(Config, WrongTypeNamesKeyAndValue) {
  const auto unit = ParseConfig<UnitConfig>("u.yaml", "episodes: many\n");
  ASSERT_FALSE(unit.ok());
  EXPECT_THAT(Message(unit.status()), HasSubstr("episodes is 'many', must be an integer"));
}

TEST(Config, EverythingThatIsWrongIsListed) {
  const auto unit = ParseConfig<UnitConfig>("u.yaml",
                                            "episode: 3\nepisodes: many\ntasks: [0, a]\n"
                                            "seed: 1\nseed: 2\nsim: {goal: 1, stepping: slow}\n");
  ASSERT_FALSE(unit.ok());
  EXPECT_THAT(Message(unit.status()), HasSubstr("u.yaml: episodes is 'many'"));
  EXPECT_THAT(Message(unit.status()),
              HasSubstr("u.yaml: tasks is '[0, a]', must be a list of integers"));
  EXPECT_THAT(Message(unit.status()), HasSubstr("u.yaml: seed is given twice; remove one"));
  EXPECT_THAT(Message(unit.status()), HasSubstr("u.yaml: unknown key 'episode'"));
  EXPECT_THAT(Message(unit.status()), HasSubstr("u.yaml: unknown key 'sim.goal'"));
  EXPECT_THAT(Message(unit.status()), HasSubstr("u.yaml: sim.stepping is 'slow'"));
}

TEST(Config, ASecondDocumentIsRefusedAndNotLeftOut) {
  const auto unit = ParseConfig<UnitConfig>("u.yaml", "seed: 1\n---\nseed: 2\n");
  EXPECT_THAT(Message(unit.status()), HasSubstr("u.yaml: a second document begins before line 3"));
}

TEST(Config, UnknownChoiceListsTheChoices) {
  const auto unit = ParseConfig<UnitConfig>("u.yaml", "sim: {goal_reference: desire}\n");
  ASSERT_FALSE(unit.ok());
  EXPECT_THAT(Message(unit.status()), HasSubstr("achieved, desired"));
}

TEST(Config, BrokenYamlIsAnErrorAndNotACrash) {
  EXPECT_FALSE(ParseConfig<UnitConfig>("u.yaml", "a: [1, 2").ok());
  EXPECT_FALSE(ParseConfig<UnitConfig>("u.yaml", "- 1\n- 2\n").ok());
  EXPECT_FALSE(ParseConfig<UnitConfig>("u.yaml", "sim: 3\n").ok());
  EXPECT_FALSE(ParseConfig<UnitConfig>("u.yaml", "sim: [1]\n").ok());
}

TEST(Config, DumpReadsBackToTheSameValues) {
  UnitConfig unit;
  unit.tasks = {3, 1};
  unit.method.Edit().tracking_gain = 0.1 + 0.2;
  unit.sim.joint_errors.offset_mode = OffsetMode::kVelocity;
  const std::string text = DumpConfig(unit);
  const auto again = ParseConfig<UnitConfig>("dump", text);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->tasks, unit.tasks);
  EXPECT_EQ(again->method->tracking_gain, 0.1 + 0.2);
  EXPECT_EQ(again->sim.joint_errors.offset_mode, OffsetMode::kVelocity);
  EXPECT_EQ(DumpConfig(*again), text);
}

TEST(Config, TextThatLooksLikeANumberStaysText) {
  UnitConfig unit;
  unit.replay_file = "123";
  const auto again = ParseConfig<UnitConfig>("dump", DumpConfig(unit));
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(again->replay_file, "123");
}

TEST(Config, OverridesReachNestedKeysAndAreChecked) {
  UnitConfig unit;
  EXPECT_TRUE(ApplyOverrides({"sim.joint_errors.tanh_width=0.02", "tasks=[0, 2]"}, unit).ok());
  EXPECT_EQ(unit.sim.joint_errors.tanh_width, 0.02);
  EXPECT_EQ(unit.tasks, (std::vector<int>{0, 2}));
  EXPECT_THAT(Message(ApplyOverrides({"sim.nothing=1"}, unit)), HasSubstr("sim.nothing"));
  EXPECT_FALSE(ApplyOverrides({"no_equals_sign"}, unit).ok());
}

TEST(Config, AnOverrideWithNothingAfterItsSignIsTheEmptyString) {
  UnitConfig unit;
  unit.replay_file = "given in a file";
  EXPECT_TRUE(ApplyOverrides({"replay_file="}, unit).ok());
  EXPECT_EQ(unit.replay_file, "");
  EXPECT_THAT(Message(ApplyOverrides({"episodes="}, unit)), HasSubstr("episodes is ''"));
}

// Texts that are kept and hashed hold only what they held before the field came.
TEST(ConfigTexts, ALateFieldStandsThereWhereItIsUsed) {
  EXPECT_THAT(DumpConfig(*MakeMethod("ours")), testing::Not(HasSubstr("observer")));
  EXPECT_THAT(DumpConfig(*MakeMethod("dob")), HasSubstr("observer: true"));
  UnitConfig unit;
  EXPECT_THAT(DumpConfig(unit),
              testing::Not(testing::AnyOf(HasSubstr("robot:"), HasSubstr("client:"))));
  unit.robot = "piper";
  unit.client.episode_s = 4;
  EXPECT_THAT(DumpConfig(unit),
              testing::AllOf(HasSubstr("robot: piper"), HasSubstr("episode_s: 4")));
  const auto read = ParseConfig<UnitConfig>("u.yaml", DumpConfig(unit));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(DumpConfig(*read), DumpConfig(unit));
  EXPECT_THAT(Message(ParseConfig<UnitConfig>("u.yaml", "client: {episode: 1}").status()),
              HasSubstr("client.episode"));
}

}  // namespace
}  // namespace robostress
