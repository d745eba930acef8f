// Planning and dividing a grid, and what a run directory says about how it was made.

#include <filesystem>
#include <set>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/config.h"
#include "eval/launch/cost_estimate.h"
#include "eval/launch/merged_sweep.h"
#include "eval/launch/progress.h"
#include "eval/plan/unit_filter.h"
#include "eval/plan/unit_text.h"
#include "eval/store/processor_kind.h"
#include "eval/store/run_directory.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/grid_programs.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

std::vector<PlannedUnit> Units(SweepGrid grid) {
  grid = *ResolveGrid(std::move(grid));
  return *ExpandUnits(grid);
}

SweepGrid ManyKinds() {
  SweepGrid grid;
  grid.suites = {"tabletop_goal", "tabletop_long"};
  grid.scenarios = {"clean", "heavy_payload", "aged_transmission"};
  grid.severities = {1, 5};
  grid.methods = {"base", "ours", "gain"};
  grid.seeds = {0, 7};
  grid.overrides = {"method.rank=2", "sim.settle_steps=4"};
  return grid;
}

TEST(AnnouncePlan, TellsOfThePicturesThatThePolicyOfLiberosSuitesLearnedFrom) {
  const auto said = [](std::vector<std::string> overrides, const std::string& suite) {
    SweepGrid grid;
    grid.libero_root = grid.robosuite_root = "somewhere";
    grid.suites = {suite};
    grid.overrides = std::move(overrides);
    testing::internal::CaptureStderr();
    AnnouncePlan("sweep", Units(grid), LaunchOptions());
    return testing::internal::GetCapturedStderr();
  };
  const std::string hint =
      "--set sim.pictures=plain, with which an episode takes a fifth to a third of the time";
  EXPECT_THAT(said({}, "libero_goal"), AllOf(HasSubstr("sweep: 16 units"), HasSubstr(hint)));
  EXPECT_THAT(said({"sim.pictures=plain"}, "libero_goal"), Not(HasSubstr(hint)));
  EXPECT_THAT(said({}, "tabletop_goal"), Not(HasSubstr(hint)));
}

TEST(AnnouncePlan, TellsOfScenesThatAPolicyHasNotLearned) {
  const auto said = [](const std::string& policy, const std::string& suite) {
    SweepGrid grid;
    grid.libero_root = grid.robosuite_root = "somewhere";
    grid.suites = {suite};
    grid.policies = {policy};
    testing::internal::CaptureStderr();
    AnnouncePlan("sweep", Units(grid), LaunchOptions());
    return testing::internal::GetCapturedStderr();
  };
  EXPECT_THAT(said("nano", "libero_goal"),
              HasSubstr("nano has not learned the words and scenes of LIBERO's tasks"));
  EXPECT_THAT(said("nano-libero", "tabletop_goal"),
              HasSubstr("nano-libero has not learned the words and scenes of the embedded suites"));
  for (const auto& [policy, suite] :
       {std::pair("nano-libero", "libero_goal"), std::pair("nano", "tabletop_goal"),
        std::pair("expert", "libero_goal")})
    EXPECT_THAT(said(policy, suite), Not(HasSubstr("not learned"))) << policy;
}

TEST(UnitText, IsWhatDumpConfigWrites) {
  UnitTexts texts;
  for (const PlannedUnit& unit : Units(ManyKinds()))
    EXPECT_EQ(texts.Of(unit), DumpConfig(unit.config)) << unit.id;
}

TEST(UnitText, IsReadAsParseConfigReadsIt) {
  UnitTextReader reader;
  for (const PlannedUnit& unit : Units(ManyKinds())) {
    const absl::StatusOr<UnitConfig> read = reader.Read("u", DumpConfig(unit.config));
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(DumpConfig(*read), DumpConfig(unit.config));
  }
  EXPECT_FALSE(reader.Read("u", "suite: a\nscenario: b\nseverity: x\npolicy: c\nseed: 0\n").ok());
  EXPECT_FALSE(reader.Read("u", "suite: a\nseverityy: 3\n").ok());
}

TEST(Filter, KeysAreCombinedAndPatternsOfOneKeyAreAlternatives) {
  const std::vector<PlannedUnit> all = Units(ManyKinds());
  const auto units =
      FilterUnits(all, {"method=base", "method=gain", "scenario=aged_*", "severity=5", "seed=7"});
  ASSERT_TRUE(units.ok()) << units.status();
  EXPECT_EQ(units->size(), 4u);
  EXPECT_EQ(units->front().id, "tabletop_goal-aged_transmission-L5-nano-base-s7");
  EXPECT_EQ(FilterUnits(all, {})->size(), all.size());
  EXPECT_EQ(FilterUnits(all, {"unit=tabletop_goal-clean-*"})->size(), 6u);
}

TEST(Filter, ListsEverythingThatIsWrongWithWhatThereIs) {
  const absl::Status status =
      FilterUnits(Units(ManyKinds()), {"methd=base", "scenario=aged_elbow", "seed=3"}).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(status.message()),
              AllOf(HasSubstr("'methd=base'"), HasSubstr("'aged_elbow'; it has: aged_transmission"),
                    HasSubstr("seed '3'; it has: 0, 7")));
}

TEST(Cost, ComparableRecordsWinOverTheDefault) {
  CostModel model;
  UnitConfig base, ours, other;
  ours.method = *MakeMethod("ours");
  other.suite = "tabletop_long";
  const double stated = model.EpisodeSeconds(base);
  EXPECT_GT(model.EpisodeSeconds(ours), stated);
  model.Add(base, 10, 30);
  EXPECT_DOUBLE_EQ(model.EpisodeSeconds(base), 3);
  EXPECT_DOUBLE_EQ(model.EpisodeSeconds(other), 3) << "the same policy and method elsewhere";
  EXPECT_NE(model.EpisodeSeconds(ours), 3);
  model.Add(other, 10, 80);
  EXPECT_DOUBLE_EQ(model.EpisodeSeconds(base), 3);
  EXPECT_DOUBLE_EQ(model.EpisodeSeconds(other), 8);
}

// docs/results/libero-pictures.md: a plain episode takes a fifth to a third.
TEST(Cost, PicturesAsTheOriginalsTakeLonger) {
  const CostModel model;
  UnitConfig original, plain;
  original.suite = plain.suite = "libero_goal";
  original.sim.pictures = SimOptions::kOriginalPictures;
  plain.sim.pictures = SimOptions::kPlainPictures;
  EXPECT_GT(model.EpisodeSeconds(original), 3 * model.EpisodeSeconds(plain));
  EXPECT_LT(model.EpisodeSeconds(original), 5 * model.EpisodeSeconds(plain));
  UnitConfig expert = original;
  expert.policy = "expert";
  EXPECT_NEAR(model.EpisodeSeconds(expert), 1, 0.3);
}

TEST(Processor, KindIsModelAndInstructionSets) {
  const ProcessorKind kind = ParseProcessor(
      "processor\t: 0\nmodel name\t: Some CPU @ 2.0GHz\nflags\t\t: fpu sse4_2 fma avx2 avx ht\n"
      "processor\t: 1\nmodel name\t: Some CPU @ 2.0GHz\nflags\t\t: fpu sse4_2 fma avx2 avx ht\n");
  EXPECT_EQ(kind.Text(), "Some CPU @ 2.0GHz [avx avx2 fma sse4_2]");
  EXPECT_EQ(ParseProcessor("").Text(), "unknown");
}

TEST(ProgressTable, HasALineForEachRunningUnitAndForFailures) {
  const std::string folder = TestFolder();
  Progress progress(Progress::Output::kNone);
  for (const char* id : {"a", "b", "c"}) progress.Expect(id, folder + "/" + id, 4);
  progress.Start("a");
  progress.Start("b");
  ASSERT_TRUE(WriteFileAtomically(folder + "/a", "1\n2\n").ok());
  std::vector<std::string> table = progress.Table(8);
  ASSERT_EQ(table.size(), 3u);
  EXPECT_THAT(table[0], HasSubstr("0/3 units  2/12 episodes (16 %)"));
  EXPECT_THAT(table[1], AllOf(HasSubstr("a "), HasSubstr("2/4")));
  EXPECT_THAT(progress.Table(1)[2], HasSubstr("1 more"));
  progress.Finish("a", false);
  progress.Finish("b", true);
  table = progress.Table(8);
  EXPECT_THAT(table[0], HasSubstr("1/3 units (1 failed)  4/12 episodes"));
  EXPECT_THAT(table[1], HasSubstr("FAILED b"));
}

class GridProgram : public ::testing::Test {
 protected:
  void SetUp() override { folder_ = TestFolder(); }
  int Sweep(const std::string& arguments, const std::string& environment = "") {
    const auto [code, text] = RunGrid(folder_, "sweep", arguments, environment);
    output_ = text;
    return code;
  }
  std::string In(const std::string& name) const { return "--out '" + folder_ + "/" + name + "' "; }
  std::string Text(const std::string& name) const {
    return ReadFile(folder_ + "/" + name).value_or("(no " + name + ")");
  }
  std::string folder_, output_;
};

TEST_F(GridProgram, PartsOnFourWorkersGiveTheSameUnitsByteByByte) {
  const std::string base = SmallGrid() + "--videos 1 ";
  ASSERT_EQ(Sweep(base + In("whole") + "--workers 1"), 0) << output_;
  ASSERT_EQ(Sweep(base + In("parts") + "--split-episodes 4 --workers 4"), 0) << output_;
  EXPECT_EQ(Text("whole/episodes.csv"), Text("parts/episodes.csv"));
  const std::string unit = "/units/tabletop_goal-heavy_payload-L5-nano-base-s0/";
  for (const char* file : {"episodes.jsonl", "DONE", "config.yaml", "provenance.json",
                           "videos/task0_episode0.webp", "videos/task1_episode0.webp"})
    EXPECT_EQ(Text("whole" + unit + file), Text("parts" + unit + file)) << file;
  EXPECT_TRUE(fs::is_empty(folder_ + "/parts/parts")) << "joined parts are removed";
  EXPECT_TRUE(fs::exists(folder_ + "/parts/logs/tabletop_goal-clean-L5-nano-base-s0.4-5.log"));
  EXPECT_FALSE(fs::exists(folder_ + "/parts/logs/tabletop_goal-clean-L5-nano-ours-s0.4-5.log"))
      << "a method that adapts is sequential";
}

TEST_F(GridProgram, AUnitIsFinishedTheWayItWasBegun) {
  ASSERT_EQ(Sweep(SmallGrid() + In("whole")), 0) << output_;
  EXPECT_EQ(Sweep(SmallGrid() + In("run") + "--split-episodes 4", "FAKE_FAIL_SCENARIO=clean"), 1);
  const std::string unit = folder_ + "/run/units/tabletop_goal-heavy_payload-L5-nano-base-s0";
  fs::remove(unit + "/DONE");  // begun undivided, as it were
  ASSERT_EQ(Sweep(SmallGrid() + In("run") + "--split-episodes 2"), 0) << output_;
  EXPECT_TRUE(fs::exists(folder_ + "/run/logs/tabletop_goal-clean-L5-nano-base-s0.4-5.log"));
  EXPECT_FALSE(fs::exists(folder_ + "/run/logs/tabletop_goal-clean-L5-nano-base-s0.2-3.log"));
  EXPECT_EQ(CountLines(unit + "/starts.txt"), 1) << "the undivided unit was started again";
  EXPECT_EQ(Text("whole/episodes.csv"), Text("run/episodes.csv"));
}

TEST_F(GridProgram, DryRunSaysWhatIsDoneAndWhatTheRestCosts) {
  EXPECT_EQ(Sweep(SmallGrid() + In("run") + "--dry-run"), 0);
  EXPECT_THAT(output_,
              AllOf(HasSubstr("0 units are done, 4 are not: 4 pieces of work, 24 episodes"),
                    HasSubstr("defaults for one core")));
  EXPECT_FALSE(fs::exists(folder_ + "/run"));
  ASSERT_EQ(Sweep(SmallGrid() + In("run") + "--only method=base"), 0) << output_;
  EXPECT_EQ(Sweep(SmallGrid() + In("run") + "--dry-run"), 0);
  EXPECT_THAT(output_,
              AllOf(HasSubstr("tabletop_goal-clean-L5-nano-base-s0  6 episodes  done"),
                    HasSubstr("2 units are done, 2 are not"), HasSubstr("from 12 recorded")));
  EXPECT_EQ(Sweep(SmallGrid() + In("run") + "--dry-run --set method.tracking_gain=0.3"), 1)
      << "what a run would refuse";
}

TEST_F(GridProgram, EveryUnitOfAnotherConfigurationIsListed) {
  ASSERT_EQ(Sweep(SmallGrid() + In("run")), 0) << output_;
  EXPECT_EQ(Sweep(SmallGrid() + In("run") + "--set method.tracking_gain=0.3"), 1);
  for (const char* id : {"clean-L5-nano-base", "clean-L5-nano-ours", "heavy_payload-L5-nano-base",
                         "heavy_payload-L5-nano-ours"})
    EXPECT_THAT(output_, HasSubstr(id));
}

TEST_F(GridProgram, UnitsLeftOutByAFilterAreNamedAsUnfinished) {
  ASSERT_EQ(Sweep(SmallGrid() + In("run") + "--only scenario=clean"), 0) << output_;
  EXPECT_THAT(output_, HasSubstr("2 unfinished units are left out"));
  EXPECT_THAT(Text("run/report.json"), HasSubstr("tabletop_goal-heavy_payload-L5-nano-ours-s0"));
  EXPECT_EQ(Sweep(SmallGrid() + In("run") + "--only scenario=cleen"), 2);
}

TEST_F(GridProgram, ProcessorsAreRecordedAndAMixtureIsSaid) {
  ASSERT_EQ(Sweep(SmallGrid() + In("run")), 0) << output_;
  EXPECT_THAT(output_, Not(HasSubstr("mixes kinds of processors")));
  const std::string unit = folder_ + "/run/units/tabletop_goal-clean-L5-nano-base-s0";
  EXPECT_THAT(*ReadFile(unit + "/machines.jsonl"),
              AllOf(HasSubstr("\"worker\""), HasSubstr("\"server\"")));
  const std::string table = Text("run/episodes.csv");
  ASSERT_TRUE(WriteFileAtomically(unit + "/machines.jsonl", "{\"worker\":\"Other CPU\"}\n").ok());
  EXPECT_EQ(RunGrid(folder_, "report", "'" + folder_ + "/run'").first, 0);
  EXPECT_THAT(Text("output.txt"),
              AllOf(HasSubstr("mixes kinds of processors"), HasSubstr("Other CPU (1 units)")));
  EXPECT_THAT(Text("run/report.html"), HasSubstr("mixes kinds of processors"));
  EXPECT_EQ(Text("run/episodes.csv"), table);
}

TEST_F(GridProgram, QuietSaysOnlyFailuresAndTheResult) {
  EXPECT_EQ(Sweep(SmallGrid() + In("run") + "--quiet --no-report", "FAKE_FAIL_SCENARIO=clean"), 1);
  EXPECT_THAT(output_, Not(HasSubstr("ETA")));
  EXPECT_THAT(output_, AllOf(HasSubstr("no simulator for scenario clean"),
                             HasSubstr("FAILED tabletop_goal-clean-L5-nano-base-s0"),
                             HasSubstr("the same command tries what failed again")));
}

}  // namespace
}  // namespace robostress
