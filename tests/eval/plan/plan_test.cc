#include "eval/plan/plan.h"

#include <cstdlib>
#include <filesystem>
#include <set>

#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/suites.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/common/libero/init_file.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

std::vector<PlannedUnit> Plan(const SweepGrid& grid) {
  const absl::StatusOr<SweepGrid> resolved = ResolveGrid(grid);
  EXPECT_TRUE(resolved.ok()) << resolved.status();
  const absl::StatusOr<std::vector<PlannedUnit>> units = ExpandUnits(*resolved);
  EXPECT_TRUE(units.ok()) << units.status();
  return *units;
}

std::vector<std::string> Ids(const std::vector<PlannedUnit>& units) {
  std::vector<std::string> ids;
  for (const PlannedUnit& unit : units) ids.push_back(unit.id);
  return ids;
}

TEST(Plan, LiberosFoldersComeFromTheEnvironmentWhereTheyAreNeeded) {
  setenv("LIBERO_ROOT", "/libero", 1);
  setenv("ROBOSUITE_ROOT", "/robosuite", 1);
  SweepGrid grid = QuickGrid();
  EXPECT_EQ(ResolveGrid(grid)->libero_root, "") << "a unit of another suite must not depend on it";
  grid.suites = {"libero_goal"};
  grid.robosuite_root = "/given";
  const absl::StatusOr<SweepGrid> resolved = ResolveGrid(grid);
  unsetenv("LIBERO_ROOT");
  unsetenv("ROBOSUITE_ROOT");
  ASSERT_TRUE(resolved.ok()) << resolved.status();
  EXPECT_EQ(resolved->libero_root, "/libero");
  EXPECT_EQ(resolved->robosuite_root, "/given");
  grid.robosuite_root.clear();
  // What `robostress libero setup` links comes last.
  const std::filesystem::path data = std::filesystem::path(::testing::TempDir()) / "libero_data";
  std::filesystem::remove_all(data);
  setenv("XDG_DATA_HOME", data.c_str(), 1);
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("run `robostress libero setup` once"));
  std::filesystem::create_directories(data / "robostress/libero/libero/libero");
  std::filesystem::create_directory_symlink("/",
                                            data / "robostress/libero/libero/libero/bddl_files");
  EXPECT_EQ(ResolveGrid(grid)->libero_root, (data / "robostress/libero").string());
  EXPECT_EQ(ResolveGrid(grid)->robosuite_root, (data / "robostress/libero").string());
  unsetenv("XDG_DATA_HOME");
}

TEST(Plan, QuickIsCleanAndSevenScenariosWithBaseThePapersFormAndOurBest) {
  const std::vector<PlannedUnit> units = Plan(QuickGrid());
  EXPECT_EQ(units.size(), 24u);
  EXPECT_EQ(units.front().id, "tabletop_object-clean-L5-nano-base-s0");
  for (const PlannedUnit& unit : units) {
    EXPECT_GE(unit.config.episodes, 10) << "a method that never fills its buffer never adapts";
    EXPECT_LE(unit.config.tasks.size(), 2u);
  }
}

TEST(Plan, EveryUnitBeginsAtTheGridsFirstInitialState) {
  SweepGrid grid = QuickGrid();
  grid.first_initial_state = 40;  // the dev split
  for (const PlannedUnit& unit : Plan(grid)) EXPECT_EQ(unit.config.first_initial_state, 40);
}

TEST(Plan, FullIsFourSuitesTenTasksTwentyEpisodes) {
  const std::vector<PlannedUnit> units = Plan(FullGrid());
  EXPECT_EQ(units.size(), 4u * 8 * 2);
  for (const PlannedUnit& unit : units) EXPECT_EQ(unit.EpisodeCount(), 200);
}

TEST(Plan, IdsAreUniqueAndFlagOrderDoesNotMatter) {
  SweepGrid a;
  a.suites = {"tabletop_goal", "tabletop_spatial"};
  a.scenarios = {"heavy_payload", "clean"};
  a.methods = {"ours", "base"};
  a.seeds = {0, 1};
  SweepGrid b = a;
  std::swap(b.suites[0], b.suites[1]);
  std::swap(b.scenarios[0], b.scenarios[1]);
  std::swap(b.methods[0], b.methods[1]);
  const std::vector<std::string> ids = Ids(Plan(a));
  EXPECT_EQ(ids, Ids(Plan(b)));
  EXPECT_EQ(std::set<std::string>(ids.begin(), ids.end()).size(), ids.size());
  EXPECT_EQ(ids.size(), 16u);
}

TEST(PolicyLabel, IsThePathsLastPartWithoutTheEndingOfWeights) {
  EXPECT_EQ(PolicyLabel("nano"), "nano");
  EXPECT_EQ(PolicyLabel("nano:random"), "nano:random");
  EXPECT_EQ(PolicyLabel("mine.safetensors"), "mine");
  EXPECT_EQ(PolicyLabel("a/b/mine-0.5.safetensors"), "mine-0.5");
  EXPECT_EQ(PolicyLabel("checkpoints/pi0.5"), "pi0.5");
  EXPECT_EQ(PolicyLabel("checkpoints/pi0.5/"), "pi0.5");
  EXPECT_NE(PolicyLabel("checkpoints/pi0"), PolicyLabel("checkpoints/pi0.5"));
  UnitConfig config;
  config.policy = "checkpoints/pi0.5";
  EXPECT_EQ(UnitId(config), "tabletop_spatial-clean-L5-pi0.5-base-s0");
  EXPECT_EQ(OlderUnitId(config), "tabletop_spatial-clean-L5-pi0-base-s0");
}

TEST(Plan, CleanIsRunAtOneLevelOnly) {
  SweepGrid grid;
  grid.scenarios = {"clean", "heavy_payload"};
  grid.methods = {"base"};
  grid.severities = {1, 3, 5};
  EXPECT_THAT(Ids(Plan(grid)), ElementsAre("tabletop_goal-clean-L5-nano-base-s0",
                                           "tabletop_goal-heavy_payload-L1-nano-base-s0",
                                           "tabletop_goal-heavy_payload-L3-nano-base-s0",
                                           "tabletop_goal-heavy_payload-L5-nano-base-s0"));
}

TEST(Plan, ExpertRunsWithBaseOnly) {
  SweepGrid grid;
  grid.scenarios = {"clean"};
  grid.policies = {"expert", "nano"};
  EXPECT_THAT(Ids(Plan(grid)), ElementsAre("tabletop_goal-clean-L5-expert-base-s0",
                                           "tabletop_goal-clean-L5-nano-base-s0",
                                           "tabletop_goal-clean-L5-nano-ours-s0"));
  grid.methods = {"ours"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("expert does not adapt"));
}

TEST(Plan, OverridesReachSimulatorAndMethod) {
  SweepGrid grid;
  grid.scenarios = {"clean"};
  grid.overrides = {"sim.goal_reference=desired", "method.learning_rate=0.5",
                    "sim.joint_errors.friction_law=stick"};
  for (const PlannedUnit& unit : Plan(grid)) {
    EXPECT_EQ(unit.config.sim.goal_reference, GoalReference::kDesired);
    EXPECT_EQ(unit.config.sim.joint_errors.friction_law, FrictionLaw::kStick);
    const LoraOptions* lora = unit.config.method->Find<LoraOptions>();
    EXPECT_EQ(lora == nullptr ? 0 : lora->learning_rate, unit.config.method->adapts() ? 0.5 : 0);
  }
}

TEST(Plan, EverythingUnknownIsListedAtOnceWithTheKnownNames) {
  SweepGrid grid;
  grid.suites = {"tabletop_gaol", "tabletop_goal"};
  grid.scenarios = {"heavy_load"};
  grid.methods = {"our"};
  grid.policies = {"pi0", "nano-piper"};
  grid.severities = {0, 6};
  grid.tasks = {11};
  grid.overrides = {"sim.frixion=1", "learning_rate=1", "method.method=gain"};
  const absl::Status status = ResolveGrid(grid).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(
      std::string(status.message()),
      AllOf(HasSubstr("'tabletop_gaol'"), HasSubstr("tabletop_long"), HasSubstr("'heavy_load'"),
            HasSubstr("aged_joint_elbow"), HasSubstr("'our'"), HasSubstr("no_anchor"),
            HasSubstr("'pi0'"), HasSubstr("'nano-piper' moves a Piper's joints"),
            HasSubstr("severity 0"), HasSubstr("severity 6"), HasSubstr("task 11"),
            HasSubstr("frixion"), HasSubstr("override of method.method"),
            HasSubstr("'learning_rate=1' must be sim.KEY=VALUE")));
}

TEST(Plan, AnotherRobotBringsItsSuitesArmsAndPolicy) {
  SweepGrid grid;
  grid.robot = "piper";
  grid.methods = {"dob_ours", "base"};
  grid.severities = {3, 5};
  grid.overrides = {"client.episode_s=4"};
  const std::vector<PlannedUnit> units = Plan(grid);
  ASSERT_EQ(units.size(), 4u * 2 * 2) << "an arm has one level";
  EXPECT_EQ(units.front().id, "piper_1_next_to_plate-new-L5-nano-piper-base-s0");
  EXPECT_EQ(units.back().id, "piper_4_open_drawer-used_one_year-L5-nano-piper-dob_ours-s0");
  EXPECT_EQ(units.back().config.robot, "piper");
  EXPECT_EQ(units.back().config.client.episode_s, 4);
  EXPECT_TRUE(units.back().config.method->observer);
  for (const PlannedUnit& unit : units) EXPECT_TRUE(ResolveUnit(unit.config).ok()) << unit.id;
}

TEST(Plan, NamesOfAnotherRobotAreUnknown) {
  SweepGrid grid;
  grid.suites = {"piper_unseen"};
  grid.scenarios = {"used_one_year"};
  grid.methods = {"dob"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              AllOf(HasSubstr("'piper_unseen'"), HasSubstr("'used_one_year'"), HasSubstr("'dob'")));
  grid.robot = "piper";
  EXPECT_TRUE(ResolveGrid(grid).ok());
  grid.policies = {"nano", "expert"};
  EXPECT_THAT(
      std::string(ResolveGrid(grid).status().message()),
      AllOf(HasSubstr("'nano' moves a Panda's hand"), HasSubstr("unknown policy 'expert'")));
  grid.robot = "puma";
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()), HasSubstr("known: panda, piper"));
}

TEST(Plan, AnOptionThatChangesNoMethodOfTheGridIsRefusedWithThoseThatDo) {
  SweepGrid grid;
  grid.methods = {"base", "ours"};
  grid.overrides = {"method.integral_limit=0.3"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              AllOf(HasSubstr("method ours has no integral_action"), HasSubstr("learning_rate")));
  grid.overrides = {"method.learning_rate=2"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("learning_rate is 2, must be 0..1"));
  grid.overrides = {"method.learning_rate=0.5"};
  EXPECT_TRUE(ResolveGrid(grid).ok()) << "base goes on without";
}

TEST(Plan, NothingAndDoublesAreRefused) {
  SweepGrid grid;
  grid.methods = {};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()), HasSubstr("no method given"));
  grid.methods = {"base", "base"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("method base is given twice"));
}

TEST(Plan, WhatAWorkerWouldRefuseIsSaidBeforeItStarts) {
  SweepGrid grid;
  grid.suites = {"tabletop_goal", "tabletop_long"};
  grid.episodes = 51;
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              AllOf(HasSubstr("tabletop_goal: episodes is 51, must be 1 to 50: every episode"),
                    HasSubstr("tabletop_long: episodes is 51")));
  grid.episodes = 2;
  grid.first_initial_state = 49;
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("episodes is 2, must be 1 to 1"));
  grid.first_initial_state = 48;
  EXPECT_TRUE(ResolveGrid(grid).ok());
  grid.overrides = {"sim.settle_steps=5000"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("sim.settle_steps is 5000, must be 0 to 1000"));
}

TEST(Plan, LiberoSuitesAskForTheirFiles) {
  SweepGrid grid;
  grid.suites = {"libero_goal"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()), HasSubstr("--libero-root"));
}

TEST(Plan, LiberosSuitesHaveAPolicyOfTheirOwn) {
  SweepGrid grid;
  grid.libero_root = grid.robosuite_root = "somewhere";
  grid.suites = {"libero_goal", "libero_10"};
  EXPECT_EQ(ResolveGrid(grid)->policies, std::vector<std::string>{"nano-libero"});
  grid.suites.push_back("tabletop_goal");
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("no policy here has learned all of libero_goal, libero_10, tabletop_goal; "
                        "name one: --policies NAME"));
  grid.policies = {"nano-pi05"};
  EXPECT_EQ(ResolveGrid(grid)->policies, std::vector<std::string>{"nano-pi05"});
}

TEST(Plan, LiberoFixturesReachEveryUnitAndAreChecked) {
  SweepGrid grid;
  for (const PlannedUnit& unit : Plan(grid)) EXPECT_EQ(unit.config.libero_fixtures, "centred");
  grid.suites = {"libero_goal"};
  grid.libero_root = grid.robosuite_root = "somewhere";
  grid.libero_fixtures = "numpy:3";
  for (const PlannedUnit& unit : Plan(grid)) EXPECT_EQ(unit.config.libero_fixtures, "numpy:3");
  grid.libero_fixtures = "centre";
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("libero_fixtures 'centre'"));
}

TEST(Plan, StepLimitsReachLiberosSuitesAndNoOthers) {
  SweepGrid grid;
  grid.suites = {"libero_spatial", "libero_10"};
  grid.libero_root = grid.robosuite_root = "somewhere";
  for (const PlannedUnit& unit : Plan(grid)) EXPECT_EQ(unit.config.horizon, 0);
  grid.step_limits = "lerobot";
  for (const PlannedUnit& unit : Plan(grid)) {
    EXPECT_EQ(unit.config.horizon, unit.config.suite == "libero_spatial" ? 280 : 520);
    EXPECT_EQ(HorizonOf(unit.config), unit.config.horizon);
    EXPECT_TRUE(ResolveUnit(unit.config).ok());
  }
  grid.suites.push_back("tabletop_goal");
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              AllOf(HasSubstr("protocol lerobot has no step limit for suite tabletop_goal"),
                    HasSubstr("it has libero_spatial, libero_object")));
  grid.step_limits = "openvla";
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("protocol 'openvla' is unknown; known: openpi, lerobot"));
  UnitConfig unit;
  EXPECT_EQ(HorizonOf(unit), 220) << "the suite's own";
  unit.horizon = -1;
  EXPECT_THAT(std::string(ResolveUnit(unit).status().message()), HasSubstr("horizon is -1"));
}

TEST(Plan, APolicyOfAnotherServerMovesAPanda) {
  SweepGrid grid;
  grid.policies = {"theirs"};
  grid.methods = {"base"};
  grid.remote.dialect.name = "openpi";
  grid.remote.action_dim = 8;
  EXPECT_THAT(std::string(ResolveGrid(grid, PolicyHome::kElsewhere).status().message()),
              HasSubstr("remote.action_dim is 8, and a Panda's command has 7 numbers"));
}

void WriteStates(const std::filesystem::path& file, int rows) {
  ASSERT_TRUE(WriteFileAtomically(file.string(), libero::InitFile(rows)).ok());
}

TEST(Plan, TwoScenariosOfOneTitleAreRefused) {
  const std::string worn = ::testing::TempDir() + "/worn.yaml",
                    old = ::testing::TempDir() + "/old.yaml";
  const auto write = [](const std::string& file, const std::string& title) {
    ASSERT_TRUE(WriteFileAtomically(file, "title: " + title + "\nbase: clean\njoints: []\n").ok());
  };
  SweepGrid grid;
  grid.scenarios = {"clean", worn, old};
  write(worn, "Worn elbow");
  write(old, "Worn elbow");
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("scenarios " + worn + " and " + old + " have one title, 'Worn elbow'"));
  write(old, "Clean");
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("scenarios clean and " + old + " have one title, 'Clean'"));
  write(old, "Old elbow");
  EXPECT_TRUE(ResolveGrid(grid).ok()) << ResolveGrid(grid).status();
}

TEST(Plan, FaultsThatAllTasksOfAFolderShareAreSaidInAFewLines) {
  const std::filesystem::path folder =
      std::filesystem::path(::testing::TempDir()) / "plan" / "libero_many";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  for (int i = 0; i < 9; ++i) {
    ASSERT_TRUE(
        WriteFileAtomically(absl::StrCat(folder.string(), "/", i, ".bddl"), libero::TaskFile("p"))
            .ok());
    WriteStates(folder / absl::StrCat(i, ".init"), 3);
  }
  SweepGrid grid;
  grid.policies = {"expert"};
  grid.methods = {"base"};
  grid.scenarios = {"clean"};
  grid.libero_root = grid.robosuite_root = "somewhere";
  grid.libero_tasks = {folder.string()};
  grid.episodes = 4;
  EXPECT_THAT(
      std::string(ResolveGrid(grid).status().message()),
      AllOf(HasSubstr("episodes start from states 0 to 3, and "), HasSubstr("task 4 of "),
            Not(HasSubstr("task 5 of ")), HasSubstr("and 4 more tasks of " + folder.string())));
}

TEST(Plan, AFolderOfTasksIsASuite) {
  const std::filesystem::path folder =
      std::filesystem::path(::testing::TempDir()) / "plan" / "libero_goal_mine";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  for (const char* task : {"a.bddl", "b.bddl"})
    ASSERT_TRUE(WriteFileAtomically((folder / task).string(), libero::TaskFile("p")).ok());
  WriteStates(folder / "a.pruned_init", 70);
  SweepGrid grid;
  grid.policies = {"expert"};
  grid.methods = {"base"};
  grid.scenarios = {"clean"};
  grid.libero_root = grid.robosuite_root = "somewhere";
  EXPECT_THAT(DumpConfig(grid), Not(HasSubstr("libero_tasks")));
  grid.libero_tasks = {folder.string()};
  EXPECT_THAT(
      std::string(ResolveGrid(grid).status().message()),
      HasSubstr("task 1 of " + folder.string() + ", b: no initial states: neither b.pruned_init"));
  grid.tasks = {0};
  EXPECT_TRUE(ResolveGrid(grid).ok());
  grid.tasks = {};
  WriteStates(folder / "b.init", 70);
  grid.first_initial_state = 60;
  grid.episodes = 10;
  EXPECT_TRUE(ResolveGrid(grid).ok()) << "how many there are the file says";
  grid.episodes = 11;
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              AllOf(HasSubstr(", a: episodes start from states 60 to 70, and "),
                    HasSubstr(", b: episodes start")));
  ASSERT_TRUE(WriteFileAtomically((folder / "b.init").string(), "").ok());
  grid.episodes = 10;
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              AllOf(HasSubstr("task 1 of " + folder.string()), HasSubstr("b.init: 0 bytes")));
  WriteStates(folder / "b.init", 70);
  ASSERT_TRUE(WriteFileAtomically((folder / "b.bddl").string(), "(define (problem p)").ok());
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              AllOf(HasSubstr("task 1 of " + folder.string() + ", b: "), HasSubstr("b.bddl:1: "),
                    Not(HasSubstr("task 0"))));
  grid.tasks = {0};
  EXPECT_TRUE(ResolveGrid(grid).ok()) << "it is not played";
  grid.tasks = {};
  ASSERT_TRUE(WriteFileAtomically((folder / "b.bddl").string(), libero::TaskFile("p")).ok());
  grid.episodes = SweepGrid().episodes;
  grid.first_initial_state = 0;
  std::vector<PlannedUnit> units = Plan(grid);
  ASSERT_EQ(units.size(), 1u);
  EXPECT_EQ(units[0].config.suite, "libero_goal_mine");
  EXPECT_EQ(units[0].config.libero_tasks, folder.string());
  EXPECT_EQ(units[0].config.tasks.size(), 2u);
  EXPECT_EQ(HorizonOf(units[0].config), 300);
  EXPECT_TRUE(ResolveUnit(units[0].config).ok());
  grid.suites = {"libero_goal", "libero_goal_mine"};
  units = Plan(grid);
  ASSERT_EQ(units.size(), 2u);
  EXPECT_EQ(units[0].config.libero_tasks, "");
  SweepGrid spaced = grid;
  const std::filesystem::path second = folder.parent_path() / "my tasks";
  std::filesystem::remove_all(second);
  std::filesystem::copy(folder, second);
  spaced.libero_tasks = {second.string()};
  spaced.suites = {};
  EXPECT_TRUE(ResolveGrid(spaced).ok()) << "no server is told its name";
  spaced.policies = {"nano-libero"};
  EXPECT_THAT(std::string(ResolveGrid(spaced).status().message()),
              HasSubstr("my tasks: its name contains byte 32; names are printable ASCII without"));
  SweepGrid both = grid;
  both.suites = {"libero_goal"};
  EXPECT_THAT(std::string(ResolveGrid(both).status().message()),
              HasSubstr("which is not among the suites given; add it, or give one of the two"));
  both.suites = {"libero_goal", folder.filename().string()};
  EXPECT_TRUE(ResolveGrid(both).ok()) << "as a run's sweep.yaml has them";
  SweepGrid embedded;
  embedded.libero_fixtures = "sampled";
  EXPECT_THAT(std::string(ResolveGrid(embedded).status().message()),
              HasSubstr("libero_fixtures sampled is of LIBERO's scenes, and none of the suites"));
  grid.libero_tasks = {folder.string() + "_not"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()), HasSubstr("libero_tasks: "));
  grid.suites = {"libero_goal_mine_not"};
  EXPECT_THAT(std::string(ExpandUnits(grid).status().message()),
              AllOf(HasSubstr("suite 'libero_goal_mine_not' is unknown"),
                    HasSubstr(folder.string() + "_not")));
}

TEST(Plan, LatencyIsPartOfEveryUnitAndStandsInNoneWithout) {
  SweepGrid grid;
  grid.scenarios = {"clean"};
  EXPECT_THAT(DumpConfig(Plan(grid)[0].config), Not(HasSubstr("latency")));
  grid.latency.ms = 150;
  grid.overrides = {"latency.mode=rtc"};
  for (const PlannedUnit& unit : Plan(grid)) {
    EXPECT_EQ(unit.config.latency.ms, 150);
    EXPECT_EQ(unit.config.latency.mode, LateChunks::kRtc);
    EXPECT_THAT(DumpConfig(unit.config), HasSubstr("mode: rtc"));
  }
  grid.policies = {"expert"};
  grid.methods = {"base"};
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("policy 'expert' cannot go on from a running chunk"));
  grid.overrides = {};
  EXPECT_TRUE(ResolveGrid(grid).ok());
  grid.latency.ms = 10001;
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("latency.ms is 10001, must be 0 to 10000"));
  grid = {};
  grid.robot = "piper";
  grid.latency.ms = 100;
  EXPECT_THAT(std::string(ResolveGrid(grid).status().message()),
              HasSubstr("its client's is client.latency_ticks"));
}

TEST(Plan, GridSurvivesItsFile) {
  SweepGrid grid = QuickGrid();
  grid.overrides = {"method.learning_rate=1e-5"};
  grid.seeds = {3, 1};
  const absl::StatusOr<SweepGrid> resolved = ResolveGrid(grid);
  ASSERT_TRUE(resolved.ok()) << resolved.status();
  const absl::StatusOr<SweepGrid> read =
      ParseConfig<SweepGrid>("sweep.yaml", DumpConfig(*resolved));
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_EQ(DumpConfig(*read), DumpConfig(*resolved));
  EXPECT_FALSE(ParseConfig<SweepGrid>("sweep.yaml", "sweets: [a]").ok());
}

TEST(ParseTasks, ReadsCountsIndicesAndRanges) {
  EXPECT_THAT(*ParseTasks("2"), ElementsAre(0, 1));
  EXPECT_THAT(*ParseTasks("0,3,7"), ElementsAre(0, 3, 7));
  EXPECT_THAT(*ParseTasks("2-4,8-8"), ElementsAre(2, 3, 4, 8));
  EXPECT_THAT(*ParseTasks("all"), ElementsAre());
  for (const char* bad : {"0", "-1", "a", "1,,2", "4-2", "1-2-3", "1.5"})
    EXPECT_FALSE(ParseTasks(bad).ok()) << bad;
}

}  // namespace
}  // namespace robostress
