// A scenario file is kept by the run that plays it, and the copy is what every reader reads.

#include <filesystem>

#include "common/atomic_file.h"
#include "common/config.h"
#include "common/unit/unit_runner.h"
#include "eval/plan/titles.h"
#include "eval/store/played_alike.h"
#include "eval/store/run_directory.h"
#include "eval/store/store_check.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/common/libero/init_file.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;

// Fails after `episodes`.
class ShortPlayer : public UnitPlayer {
 public:
  explicit ShortPlayer(int episodes) : left_(episodes) {}
  absl::StatusOr<std::string> Open() override { return "model"; }
  absl::StatusOr<PlayedEpisode> Play(const PlannedEpisode&, UnitDirectory&) override {
    if (left_-- == 0) return absl::UnavailableError("interrupted");
    return PlayedEpisode();
  }

 private:
  int left_;
};

std::string WornElbow(const std::string& base, double delay_s) {
  return absl::StrCat("title: Worn elbow\nbase: ", base,
                      "\njoints: [{name: J4, effects: [{type: transport_delay, delay_s: ", delay_s,
                      "}]}]\n");
}

class KeptScenario : public ::testing::Test {
 protected:
  void SetUp() override {
    Write("worn.yaml", WornElbow("clean", 0.02));
    SweepGrid grid;
    grid.scenarios = {folder_ + "/worn.yaml"};
    grid.severities = {2, 4};
    grid.methods = {"base"};
    grid.tasks = {0};
    grid.episodes = 3;
    grid_ = *ResolveGrid(grid);
  }
  void Write(const std::string& name, const std::string& text) {
    ASSERT_TRUE(WriteFileAtomically(folder_ + "/" + name, text).ok());
  }
  // Plays the grid's units of level-less scenarios, of which there is one.
  absl::Status Play(int episodes) {
    const std::vector<PlannedUnit> units = *ExpandUnits(grid_);
    EXPECT_EQ(units.size(), 1u);
    if (const absl::Status status = run_.Prepare(grid_, units); !status.ok()) return status;
    if (const absl::Status status = run_.WritePlan(units[0]); !status.ok()) return status;
    const std::string plan = run_.PlanFile(units[0].id);
    UnitRunOptions options;
    options.out = run_.Unit(units[0].id);
    ShortPlayer player(episodes);
    return RunUnit(*ResolveUnit(*ReadUnit(plan, *ReadFile(plan))), options, player);
  }
  const std::string id_ = "tabletop_goal-worn-L4-nano-base-s0";
  const std::string folder_ = TestFolder();
  const RunDirectory run_{folder_ + "/run"};
  SweepGrid grid_;
};

TEST_F(KeptScenario, IsWhatIsPlayed) {
  EXPECT_EQ(Play(1).code(), absl::StatusCode::kUnavailable);
  const auto played = LoadConfig<UnitConfig>(run_.Unit(id_) + "/config.yaml");
  ASSERT_TRUE(played.ok()) << played.status();
  EXPECT_EQ(played->scenario, run_.path() + "/scenarios/worn.yaml");
  EXPECT_TRUE(Play(3).ok()) << "and goes on";
}

TEST_F(KeptScenario, AnotherFileDoesNotGoOn) {
  EXPECT_FALSE(Play(1).ok());
  ASSERT_TRUE(WriteFileAtomically(run_.KeptScenario("worn.yaml"), WornElbow("clean", 0.04)).ok());
  Write("worn.yaml", WornElbow("clean", 0.04));
  EXPECT_THAT(std::string(Play(3).message()),
              AllOf(HasSubstr(id_ + "' was begun with a scenario file whose SHA-256 begins "),
                    HasSubstr("restore it")));
}

// Three episodes of task 0, below this root of LIBERO's and robosuite's.
SweepGrid ExpertGrid(const std::string& root) {
  SweepGrid grid;
  grid.libero_root = grid.robosuite_root = root;
  grid.scenarios = {"clean"};
  grid.methods = {"base"};
  grid.policies = {"expert"};
  grid.tasks = {0};
  grid.episodes = 3;
  return grid;
}

// The hash of a task folder is kept with what was played in it.
class KeptTasks : public KeptScenario {
 protected:
  void SetUp() override {
    fs::create_directories(tasks_);
    Write(name_ + "/put_it_there.bddl", libero::TaskFile("first"));
    Write(name_ + "/put_it_there.pruned_init", libero::InitFile(3));
    SweepGrid grid = ExpertGrid("somewhere");
    grid.libero_tasks = {tasks_};
    grid_ = *ResolveGrid(grid);
  }
  // A suite's name is its folder's, and there is one of a name in a process.
  const std::string name_ = testing::UnitTest::GetInstance()->current_test_info()->name();
  const std::string tasks_ = folder_ + "/" + name_;
};

TEST_F(KeptTasks, OtherTasksDoNotJoinThoseThatWerePlayed) {
  ASSERT_TRUE(Play(3).ok());
  SweepGrid more = grid_;
  more.seeds = {0, 1};
  EXPECT_TRUE(run_.CheckStarted(more, *ExpandUnits(more)).ok());
  for (const char* changed : {"put_it_there.bddl", "put_it_there.pruned_init"}) {
    const std::string file = tasks_ + "/" + changed, before = *ReadFile(file);
    ASSERT_TRUE(WriteFileAtomically(file, "other").ok());
    EXPECT_THAT(std::string(run_.CheckStarted(more, *ExpandUnits(more)).message()),
                AllOf(HasSubstr(tasks_ + " has changed since "), HasSubstr("restore it")));
    more.seeds = {1};  // without the unit that was played
    EXPECT_THAT(std::string(run_.CheckStarted(more, *ExpandUnits(more)).message()),
                HasSubstr("suite " + name_ + ": libero_tasks is sha256 "));
    more.seeds = {0, 1};
    ASSERT_TRUE(WriteFileAtomically(file, before).ok());
  }
  fs::remove_all(tasks_);
  EXPECT_TRUE(LoadRun(run_.path()).ok()) << "a run is read where its folder is gone";
}

TEST_F(KeptTasks, AUnitDoesNotGoOnInOtherTasks) {
  EXPECT_FALSE(Play(1).ok());
  Write(name_ + "/put_it_there.bddl", libero::TaskFile("second"));
  EXPECT_THAT(std::string(Play(3).message()), HasSubstr(tasks_ + " has changed since "));
  Write(name_ + "/put_it_there.bddl", libero::TaskFile("first"));
  EXPECT_TRUE(Play(3).ok());
}

// On another machine the same path may hold other tasks, of which only the worker knows.
TEST_F(KeptTasks, TheWorkerRefusesOtherTasksToo) {
  EXPECT_FALSE(Play(1).ok());
  const std::vector<PlannedUnit> units = *ExpandUnits(grid_);
  Write(name_ + "/put_it_there.bddl", libero::TaskFile("second"));
  UnitRunOptions options;
  options.out = run_.Unit(units[0].id);
  ShortPlayer player(3);
  EXPECT_THAT(std::string(RunUnit(*ResolveUnit(units[0].config), options, player).message()),
              HasSubstr("was begun with LIBERO tasks whose SHA-256 begins "));
}

TEST_F(KeptTasks, AUnitThatPlayedNothingYetIsPlayedInWhatIsThereNow) {
  EXPECT_FALSE(Play(0).ok());
  Write(name_ + "/put_it_there.bddl", libero::TaskFile("second"));
  EXPECT_TRUE(Play(3).ok());
}

// LIBERO's own suites lie somewhere, too, and may have been edited there.
class KeptLibero : public KeptScenario {
 protected:
  void SetUp() override {
    fs::create_directories(tasks_);
    Write("libero/bddl_files/libero_goal/turn_on_the_stove.bddl", libero::TaskFile("first"));
    SweepGrid grid = ExpertGrid(folder_ + "/libero");
    grid.suites = {"libero_goal"};
    grid_ = *ResolveGrid(grid);
  }
  const std::string tasks_ = folder_ + "/libero/bddl_files/libero_goal";
};

TEST_F(KeptLibero, OtherTasksDoNotJoinThoseThatWerePlayed) {
  ASSERT_TRUE(Play(3).ok());
  SweepGrid more = grid_;
  more.seeds = {0, 1};
  EXPECT_TRUE(run_.CheckStarted(more, *ExpandUnits(more)).ok());
  fs::rename(folder_ + "/libero", folder_ + "/elsewhere");
  EXPECT_TRUE(run_.CheckStarted(more, *ExpandUnits(more)).ok()) << "as on a planner without them";
  fs::rename(folder_ + "/elsewhere", folder_ + "/libero");
  Write("libero/bddl_files/libero_goal/turn_on_the_stove.bddl", libero::TaskFile("second"));
  EXPECT_THAT(std::string(run_.CheckStarted(more, *ExpandUnits(more)).message()),
              AllOf(HasSubstr("LIBERO's libero_goal has changed since "), HasSubstr("restore it")));
  more.seeds = {1};
  EXPECT_THAT(std::string(run_.CheckStarted(more, *ExpandUnits(more)).message()),
              HasSubstr("suite libero_goal: libero_tasks is sha256 "));
  const std::string provenance = run_.Unit(ExpandUnits(grid_)->front().id) + "/provenance.json";
  const std::string kept = *ReadFile(provenance);
  ASSERT_TRUE(WriteFileAtomically(provenance, "{\"model_hash\": \"\"}").ok());
  EXPECT_TRUE(run_.CheckStarted(more, *ExpandUnits(more)).ok()) << "one of 0.1 says nothing";
  // A report says where files are not the published ones.
  const auto noted = [&](const std::string& text) {
    nlohmann::json notes = nlohmann::json::parse(kept);
    notes["libero_files"] = text;
    EXPECT_TRUE(WriteFileAtomically(provenance, notes.dump()).ok());
    return LiberoFilesNote(*LoadRun(run_.path()));
  };
  EXPECT_EQ(noted("as published"), "");
  EXPECT_EQ(noted("2 of 300 differ"),
            "Not played on LIBERO as it was published. 1 unit: 2 of 300 differ.");
}

TEST_F(KeptScenario, ACopyThatIsNotWhatWasPlayedIsDamage) {
  ASSERT_TRUE(Play(3).ok());
  EXPECT_TRUE(CheckStores({run_.path()})->findings.empty());
  ASSERT_TRUE(WriteFileAtomically(run_.KeptScenario("worn.yaml"), WornElbow("clean", 0.04)).ok());
  const StoreContents contents = *CheckStores({run_.path()});
  ASSERT_EQ(contents.findings.size(), 1u);
  EXPECT_THAT(contents.findings[0].text,
              AllOf(HasSubstr("scenario_sha256 is "), HasSubstr("scenarios/worn.yaml has ")));
  EXPECT_THAT(std::string(LoadRun(run_.path()).status().message()), HasSubstr("scenario_sha256"));
}

TEST_F(KeptScenario, StandsForTheUsersFileWhenThatIsGone) {
  ASSERT_TRUE(Play(3).ok());
  for (const bool gone : {false, true}) {
    if (gone) fs::remove(folder_ + "/worn.yaml");
    const absl::StatusOr<RunData> data = LoadRun(run_.path());
    ASSERT_TRUE(data.ok()) << data.status();
    EXPECT_TRUE(data->unfinished.empty()) << "it has one level, planned at the highest";
    const std::string& scenario = data->units.at(0).config.scenario;
    EXPECT_EQ(ScenarioTitle(scenario), "Worn elbow");
    EXPECT_TRUE(SameAtEveryLevel(scenario));
    EXPECT_TRUE(CheckStores({run_.path()})->findings.empty());
  }
}

// Versions up to 0.2 planned and played the user's own file, and noted no hash.
TEST_F(KeptScenario, AnOlderRunGoesOn) {
  EXPECT_FALSE(Play(1).ok());
  const std::vector<PlannedUnit> units = *ExpandUnits(grid_);
  const std::string folder = run_.Unit(id_);
  ASSERT_TRUE(WriteFileAtomically(run_.PlanFile(id_), DumpConfig(units[0].config)).ok());
  ASSERT_TRUE(
      WriteFileAtomically(folder + "/config.yaml", DumpConfig(*ResolveUnit(units[0].config))).ok());
  ASSERT_TRUE(WriteFileAtomically(folder + "/provenance.json",
                                  R"({"model_hash":"model","policy":"nano","version":"0.2"})")
                  .ok());
  EXPECT_TRUE(Play(2).ok());
  EXPECT_TRUE(CheckStores({run_.path()})->findings.empty());
}

}  // namespace
}  // namespace robostress
