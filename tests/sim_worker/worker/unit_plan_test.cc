#include "common/unit/unit_plan.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/config.h"
#include "common/unit/robots.h"
#include "sim_worker/worker/sim_unit.h"

namespace robostress {
namespace {

std::vector<std::string> PandasMethods() { return FindRobot("panda")->methods; }

using ::testing::HasSubstr;

TEST(UnitPlanTest, MethodSectionStartsFromThePresetItNames) {
  const absl::StatusOr<UnitConfig> unit = ReadUnit(
      "unit.yaml", "method: {method: ours_intent, learning_rate: 0.5, tracking_gain: 0.25}");
  ASSERT_TRUE(unit.ok()) << unit.status();
  EXPECT_TRUE(unit->method->adapts());
  EXPECT_EQ(unit->method->target, TargetReference::kIntent);
  EXPECT_EQ(unit->method->Find<LoraOptions>()->learning_rate, 0.5);
  EXPECT_EQ(unit->method->tracking_gain, 0.25);
}

TEST(UnitPlanTest, DumpedUnitReadsBackEqual) {
  const absl::StatusOr<UnitConfig> unit =
      ReadUnit("", "method: {method: ours, adapt: false}\ntasks: [3, 1]");
  ASSERT_TRUE(unit.ok()) << unit.status();
  EXPECT_FALSE(unit->method->adapts()) << "given keys win over the preset";
  const absl::StatusOr<UnitConfig> again = ReadUnit("", DumpConfig(*unit));
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(DumpConfig(*again), DumpConfig(*unit));
}

TEST(UnitPlanTest, OverridesSelectThePresetFirst) {
  const absl::StatusOr<UnitConfig> unit =
      ReadUnit("", "", {"method.learning_rate=0.25", "method.method=no_anchor", "tasks=[2]"});
  ASSERT_TRUE(unit.ok()) << unit.status();
  EXPECT_EQ(unit->method->Find<LoraOptions>()->learning_rate, 0.25);
  EXPECT_EQ(unit->method->Find<LoraOptions>()->anchor_weight, 0);
  EXPECT_TRUE(unit->method->adapts());
  EXPECT_EQ(unit->tasks, std::vector<int>{2});
}

TEST(UnitPlanTest, BadInputNamesKeyValueAndWhatIsAllowed) {
  const std::pair<const char*, const char*> cases[] = {
      {"siute: tabletop_goal", "unknown key 'siute'"},
      {"method: {learning_rat: 1}", "unknown key 'method.learning_rat'"},
      {"sim: {joint_errors: {friction_law: glue}}", "sgn, tanh, stick"},
      {"episodes: many", "episodes is 'many', must be an integer"},
      {"suite: [", "unit.yaml"},
      {"method: {method: ourz}", "unknown method 'ourz'; known: base, ours"},
      {"suite: tabletop_gaol", "unknown suite 'tabletop_gaol'; known: tabletop_spatial"},
      {"scenario: rusty", "rusty"},
      {"severity: 9", "severity is 9, must be 1 to 5"},
      {"tasks: [0, 10]", "tasks is 10, must be 0 to 9"},
      {"tasks: [4, 4]", "tasks lists task 4 twice"},
      {"episodes: 0", "episodes is 0, must be 1 to 50"},
      {"{episodes: 20, first_initial_state: 40}", "episodes is 20, must be 1 to 10"},
      {"first_initial_state: 50", "first_initial_state is 50, must be 0 to 49"},
      {"videos: -1", "videos is -1"},
      {"policy: ''", "policy is empty"},
      {"latency: {ms: -1}", "latency.ms is -1, must be 0 to 10000"},
      {"latency: {fade_steps: 1001}", "latency.fade_steps is 1001, must be 0 to 1000"},
      {"latency: {mode: wait}", "waiting, switch, crossfade, rtc"},
      {"latency: {moved_bound: .nan}", "latency.moved_bound"},
      {"{policy: replay, latency: {ms: 50, mode: rtc}}", "policy 'replay' cannot go on"},
      {"{method: {method: ours_following_step}, latency: {ms: 50}}", "corrects every step"},
      {"{method: {method: ours, execute_steps: 2}, latency: {ms: 50}}", "has execute_steps 2"},
      {"{sim: {sensing: {delay: -1}}}", "sim.sensing.delay is -1, must be 0 to 100"},
      {"{sim: {sensing: {noise: 1}}}", "sim.sensing.noise is 1, must be 0 to 0.1"},
      {"{sim: {pictures: quick}}", "sim.pictures is 'quick', must be original or plain"},
      {"{sim: {pictures: plain}}", "which is of LIBERO's views; suite 'tabletop_spatial'"},
      {"{sim: {controller_kp: 0}}", "sim.controller_kp is 0, must be 1 to 2000"},
      {"{sim: {joint_errors: {tanh_width: -0.01}}}", "sim.joint_errors.tanh_width is -0.01 rad/s"},
      {"{sim: {joint_errors: {tanh_width: .inf}}}", "tanh_width is inf rad/s, must be finite"},
      {"{sim: {joint_errors: {tanh_width: 0}}}", "tanh_width is 0 rad/s"},
      {"{policy: expert, method: {method: ours}}", "policy 'expert' has nothing to adapt"},
  };
  for (const auto& [yaml, message] : cases) {
    const absl::StatusOr<UnitConfig> read = ReadUnit("unit.yaml", yaml);
    const absl::Status status = read.ok() ? ResolveUnit(*read).status() : read.status();
    ASSERT_FALSE(status.ok()) << yaml;
    EXPECT_THAT(std::string(status.message()), HasSubstr(message)) << yaml;
  }
}

TEST(UnitPlanTest, EpisodesRunTaskByTaskFromTheFirstInitialState) {
  UnitConfig unit;
  unit.tasks = {7, 2};
  unit.episodes = 2;
  unit.first_initial_state = 40;
  unit.videos = 1;
  const std::vector<PlannedEpisode> plan = PlanEpisodes(*ResolveUnit(unit));
  ASSERT_EQ(plan.size(), 4u);
  EXPECT_EQ(plan[1].task, 7);
  EXPECT_EQ(plan[1].episode, 1);
  EXPECT_EQ(plan[1].initial_state, 41);
  EXPECT_TRUE(plan[2].film);
  EXPECT_FALSE(plan[3].film);
  EXPECT_EQ(plan[2].task, 2);
}

TEST(UnitPlanTest, RangeIsOfTheWholeOrderAndRefusedWhereEpisodesDependOnEachOther) {
  UnitConfig unit;
  unit.tasks = {7, 2};
  unit.episodes = 2;
  const UnitConfig resolved = *ResolveUnit(unit);
  const absl::StatusOr<std::vector<PlannedEpisode>> part = PlanRange(resolved, "1-2");
  ASSERT_TRUE(part.ok()) << part.status();
  ASSERT_EQ(part->size(), 2u);
  EXPECT_EQ(part->front().task, 7);
  EXPECT_EQ(part->front().episode, 1);
  EXPECT_EQ(part->back().task, 2);
  EXPECT_EQ(PlanRange(resolved, "")->size(), 4u);
  for (const char* bad : {"2-1", "0-4", "1", "a-b", "-1-2"})
    EXPECT_FALSE(PlanRange(resolved, bad).ok()) << bad;
  unit.method = *MakeMethod("ours");
  EXPECT_THAT(std::string(PlanRange(*ResolveUnit(unit), "0-1").status().message()),
              HasSubstr("carries"));
}

TEST(UnitPlanTest, ResolvedUnitNamesEveryTask) {
  const absl::StatusOr<UnitConfig> resolved = ResolveUnit(UnitConfig());
  ASSERT_TRUE(resolved.ok()) << resolved.status();
  EXPECT_EQ(resolved->tasks.size(), 10u);
}

TEST(UnitPlanTest, EpisodesOfAnEstimateThatIsCarriedAreNotTornApart) {
  UnitConfig unit;
  unit.episodes = 2;
  for (const std::string& method : PandasMethods()) {
    unit.method = *MakeMethod(method);
    const bool carries = unit.method->adapts() || method == "ours_integral" ||
                         method == "ours_replanning" || method == "ours_panda" ||
                         method.starts_with("ours_following");
    EXPECT_EQ(PlanRange(*ResolveUnit(unit), "0-1").ok(), !carries) << method;
  }
}

TEST(UnitPlanTest, ASessionIsOfTheUnit) {
  UnitConfig unit;
  unit.suite = "tabletop_long";
  unit.scenario = "aged_joint_elbow";
  unit.severity = 2;
  unit.policy = "nano-pi05";
  unit.seed = 7;
  unit.sim.goal_reference = GoalReference::kDesired;
  unit.method = *MakeMethod("ours_intent");
  const RequestedSession spec = SessionOf(unit);
  EXPECT_EQ(spec.suite, "tabletop_long");
  EXPECT_EQ(spec.scenario, "aged_joint_elbow");
  EXPECT_EQ(spec.severity, 2);
  EXPECT_EQ(spec.policy, "nano-pi05");
  EXPECT_EQ(spec.seed, 7);
  EXPECT_EQ(spec.goal_reference, GoalReference::kDesired);
  EXPECT_EQ(spec.mode, ExecutionMode::kLockstep);
  EXPECT_EQ(spec.method_yaml, DumpConfig(*unit.method));
}

TEST(UnitPlanTest, AnotherRobotHasItsOwnSuitesArmsAndMethods) {
  const auto message = [](const char* yaml) {
    const absl::StatusOr<UnitConfig> read = ReadUnit("unit.yaml", yaml);
    return std::string((read.ok() ? ResolveUnit(*read).status() : read.status()).message());
  };
  EXPECT_EQ(message("{robot: piper, suite: piper_4_open_drawer, scenario: new, policy: nano-piper, "
                    "method: {method: dob_ours}}"),
            "");
  EXPECT_THAT(message("robot: puma"), HasSubstr("unknown robot 'puma'; known: panda, piper"));
  EXPECT_THAT(message("{robot: piper, suite: tabletop_goal, scenario: new}"),
              HasSubstr("unknown suite 'tabletop_goal'; known: piper_1_next_to_plate"));
  EXPECT_THAT(message("suite: piper_unseen"), HasSubstr("known: tabletop_spatial"));
  EXPECT_THAT(message("{robot: piper, suite: piper_unseen, scenario: heavy_payload}"),
              HasSubstr("known: new, used_one_year"));
  EXPECT_THAT(message("method: {method: dob}"), HasSubstr("unknown method 'dob'; known: base"));
  EXPECT_THAT(message("{robot: piper, suite: piper_unseen, scenario: new, episodes: 201}"),
              HasSubstr("episodes is 201, must be 1 to 200"));
}

TEST(UnitPlanTest, StatesGoOnFromTaskToTaskWhereTheSuiteSaysSo) {
  UnitConfig unit;
  unit.robot = "piper";
  unit.suite = "piper_unseen";
  unit.scenario = "new";
  unit.episodes = 2;
  const std::vector<PlannedEpisode> plan = PlanEpisodes(*ResolveUnit(unit));
  ASSERT_EQ(plan.size(), 10u);
  for (int i = 0; i < 10; ++i) {
    EXPECT_EQ(plan[i].task, i / 2);
    EXPECT_EQ(plan[i].episode, i % 2);
    EXPECT_EQ(plan[i].initial_state, i);
  }
  EXPECT_THAT(std::string(PlanRange(*ResolveUnit(unit), "0-1").status().message()),
              HasSubstr("robot 'piper' carries where its arm stands"));
}

TEST(ReadUnit, AMethodSectionBeginsWithItsPresetInAFileAndInAnOverride) {
  const std::string wanted = DumpConfig(*MakeMethod("ours", {"rank=4"}));
  for (const auto& unit :
       {ReadUnit("unit.yaml", "method: {method: ours, rank: 4}"),
        ReadUnit("", "", {"method={method: ours, rank: 4}"}),
        ReadUnit("", "", {"method={method: ours}", "method.rank=4"}),
        ReadUnit("unit.yaml", "method: {method: gain}", {"method={method: ours, rank: 4}"})}) {
    ASSERT_TRUE(unit.ok()) << unit.status();
    EXPECT_EQ(DumpConfig(*unit->method), wanted);
  }
  EXPECT_THAT(std::string(ReadUnit("", "", {"method=ours"}).status().message()),
              testing::HasSubstr("override 'method=ours': method must be a section"));
}

TEST(ReadUnit, TheMethodNullIsNotTakenForNoMethod) {
  const auto quoted = ReadUnit("unit.yaml", "method: {method: \"null\"}");
  ASSERT_TRUE(quoted.ok()) << quoted.status();
  EXPECT_EQ(quoted->method->noise_stream, "null");
  const auto override = ReadUnit("", "", {"method.method=null"});
  ASSERT_TRUE(override.ok()) << override.status();
  EXPECT_EQ(override->method->noise_stream, "null");
  EXPECT_EQ(override->method->method, "null");
  EXPECT_THAT(std::string(ReadUnit("unit.yaml", "method: {method: null}").status().message()),
              testing::HasSubstr("unit.yaml: method.method is YAML's null"));
}

}  // namespace
}  // namespace robostress
