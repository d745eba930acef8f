#include "eval/piper_study/piper_study.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <functional>
#include <set>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "common/unit/unit_directory.h"
#include "eval/piper_study/piper_study_page.h"
#include "eval/store/run_store.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::UnorderedElementsAre;

std::string Folder(const std::string& name) {
  const std::string folder = ::testing::TempDir() + "/piper_study_" + name;
  std::filesystem::remove_all(folder);
  EXPECT_TRUE(MakeDirectories(folder).ok());
  return folder;
}

absl::StatusOr<std::vector<PlannedUnit>> UnitsOf(const PiperStudyOptions& options) {
  RS_ASSIGN_OR_RETURN(const std::vector<PiperTablePlan> plans,
                      PlanPiperStudy(options, ProtocolOf(options, "s"), PolicyHome::kElsewhere));
  std::vector<PlannedUnit> all;
  std::set<std::string> ids;
  for (const PiperTablePlan& plan : plans) {
    RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, PaperUnits(plan.grids));
    for (const PlannedUnit& unit : units) {
      if (ids.insert(unit.id).second) all.push_back(unit);
    }
  }
  return all;
}

TEST(PiperStudyPlan, HoldsEveryCellOfThePapersTablesOnce) {
  const auto units = UnitsOf({});
  ASSERT_TRUE(units.ok()) << units.status();
  EXPECT_EQ(units->size(), 2u * 4 * 3 + 2 + 3);
  for (const PlannedUnit& unit : *units) EXPECT_EQ(unit.EpisodeCount(), 25) << unit.id;
}

TEST(PiperStudyPlan, TheObserverAloneBringsWhatItIsComparedWith) {
  PiperStudyOptions options;
  options.experiments = {"dob"};
  const auto units = UnitsOf(options);
  ASSERT_TRUE(units.ok()) << units.status();
  std::vector<std::string> methods;
  for (const PlannedUnit& unit : *units) {
    EXPECT_EQ(unit.config.suite, "piper_1_next_to_plate");
    EXPECT_EQ(unit.config.scenario, "new");
    methods.push_back(unit.config.method->method);
  }
  EXPECT_THAT(methods, UnorderedElementsAre("base", "ours", "dob", "dob_ours"));
}

TEST(PiperStudyPlan, AUnitSaysEverythingThatDecidesIt) {
  PiperStudyOptions options;
  options.overrides = {"learning_rate=3e-5"};
  options.episode_s = 4;
  options.moved_bound = 0.2;
  options.seed = 7;
  const auto units = UnitsOf(options);
  ASSERT_TRUE(units.ok()) << units.status();
  for (const PlannedUnit& unit : *units) {
    const UnitConfig& config = unit.config;
    EXPECT_EQ(config.client.episode_s, 4) << unit.id;
    EXPECT_EQ(config.client.moved_bound, 0.2) << unit.id;
    EXPECT_EQ(config.seed, 7) << unit.id;
    EXPECT_FALSE(config.client.real_time) << unit.id;
    const LoraOptions* lora = config.method->Find<LoraOptions>();
    EXPECT_TRUE(lora == nullptr || lora->learning_rate == 3e-5)
        << unit.id << ": overrides change what adapts, and nothing else";
  }
}

TEST(PiperStudyPlan, RealTimeStandsInItsUnits) {
  PiperStudyLaunch launch;
  launch.out = "s";
  launch.real_time = true;
  launch.udp_port = 43999;
  const auto plans = PlanOf({}, launch, PolicyHome::kElsewhere);
  ASSERT_TRUE(plans.ok()) << plans.status();
  const auto units = PaperUnits(plans->front().grids);
  ASSERT_TRUE(units.ok()) << units.status();
  EXPECT_TRUE(units->front().config.client.real_time);
  EXPECT_EQ(units->front().config.client.udp_port, 43999);
  EXPECT_EQ(launch.RunFolder(), "s/live");
}

TEST(PiperStudyPlan, NamesFieldValueAndRemedyOfWhatIsWrong) {
  const auto refused = [](const std::function<void(PiperStudyOptions&)>& change) {
    PiperStudyOptions options;
    change(options);
    return std::string(UnitsOf(options).status().message());
  };
  EXPECT_THAT(refused([](auto& o) { o.tasks = {5}; }), AllOf(HasSubstr("5"), HasSubstr("1 to 4")));
  EXPECT_THAT(refused([](auto& o) { o.experiments = {"sabotage"}; }), HasSubstr("unseen"));
  EXPECT_THAT(refused([](auto& o) { o.episodes = 7; }), HasSubstr("multiple of 5"));
  EXPECT_THAT(refused([](auto& o) { o.base_weights = "b"; }), HasSubstr("robust_weights"));
  EXPECT_THAT(refused([](auto& o) {
                o.base_weights = "a/nano.safetensors";
                o.robust_weights = "b/nano.safetensors";
              }),
              HasSubstr("both called 'nano'"));
  EXPECT_THAT(refused([](auto& o) { o.overrides = {"learning=1"}; }), HasSubstr("learning_rate"));
  EXPECT_THAT(refused([](auto& o) { o.arms = {}; }), HasSubstr("arms"));
  EXPECT_THAT(refused([](auto& o) { o.arms = {"rusty"}; }), HasSubstr("used_one_year"));
}

// A finished unit of a study, as the runner leaves it: episode i succeeded where `successes` has a
// 1.
void WriteUnit(const std::string& out, const PlannedUnit& unit, const std::string& successes) {
  const auto directory = UnitDirectory::Open(absl::StrCat(out, "/units/", unit.id),
                                             *ResolveUnit(unit.config), PlanEpisodes(unit.config));
  ASSERT_TRUE(directory.ok()) << directory.status();
  ASSERT_TRUE((*directory)->CheckModel(unit.config.policy, unit.config.policy).ok());
  for (const PlannedEpisode& planned : PlanEpisodes(unit.config)) {
    EpisodeRow row;
    row.success = successes[static_cast<size_t>(planned.episode)] == '1';
    row.updates = unit.config.method->adapts() ? 9 : 0;
    row.residual = 0.25;
    row.steps = 100;
    ASSERT_TRUE((*directory)
                    ->Append(EpisodeLine(IdentityOf(unit.config, planned), row),
                             TimingLine({planned.task, planned.episode}), nullptr)
                    .ok());
  }
  ASSERT_TRUE((*directory)->Finish(nullptr).ok());
}

TEST(PiperStudyReport, ComparesMethodsOnTheSameInitialStates) {
  const std::string out = Folder("report");
  PiperStudyOptions options;
  options.arms = {"new"};
  options.tasks = {1};
  options.experiments = {"main"};
  options.episodes = 10;
  const PaperProtocol protocol = ProtocolOf(options, out);
  const auto plans = PlanPiperStudy(options, protocol, PolicyHome::kElsewhere);
  ASSERT_TRUE(plans.ok()) << plans.status();
  const std::vector<PlannedUnit> units = PaperUnits(plans->front().grids).value();
  for (const PlannedUnit& unit : units) {
    if (unit.config.policy == protocol.robust) continue;
    WriteUnit(out, unit, unit.config.method->adapts() ? "1110110000" : "1100010000");
  }
  const auto run = LoadRun(out);
  ASSERT_TRUE(run.ok()) << run.status();
  ASSERT_TRUE(WritePiperPage(*plans, protocol, *run).ok());
  const auto page = ReadFile(out + "/report.md"), table = ReadFile(out + "/tables/real-arm.csv");
  ASSERT_TRUE(page.ok() && table.ok());
  EXPECT_THAT(*page, AllOf(HasSubstr("+20.0"), HasSubstr("+2/-0"),
                           HasSubstr("1 of 3 planned units are not finished")));
  EXPECT_TRUE(std::filesystem::exists(out + "/report.html"));
  const std::string& first = *page;
  ASSERT_TRUE(WritePiperPage(*plans, protocol, *run).ok());
  EXPECT_EQ(*ReadFile(out + "/report.md"), first);
}

TEST(PiperStudyReport, TellsTheObjectVariantsApart) {
  const std::string out = Folder("variants");
  PiperStudyOptions options;
  options.experiments = {"unseen"};
  options.episodes = 10;  // two of each
  const PaperProtocol protocol = ProtocolOf(options, out);
  const auto plans = PlanPiperStudy(options, protocol, PolicyHome::kElsewhere);
  ASSERT_TRUE(plans.ok()) << plans.status();
  const std::vector<PlannedUnit> units = PaperUnits(plans->front().grids).value();
  for (const PlannedUnit& unit : units) WriteUnit(out, unit, "10");
  const auto run = LoadRun(out);
  ASSERT_TRUE(run.ok()) << run.status();
  ASSERT_TRUE(WritePiperPage(*plans, protocol, *run).ok());
  EXPECT_THAT(*ReadFile(out + "/report.md"), HasSubstr("| task 4 | 1/2 | 1/2 | 1/2 |"));
}

TEST(PiperStudyReport, SaysWhichWordsThePolicyDoesNotKnow) {
  const std::string weights = Folder("words") + "/nano.safetensors";
  SafetensorsWriter writer;
  writer.SetMetadata("vocabulary", "pick up the bowl gray");
  writer.AddFloats("x", {1}, std::vector<float>{0});
  ASSERT_TRUE(writer.Write(weights).ok());
  const auto words = UnknownWords(weights, "Pick up the plum-colored bowl, the plum-colored one");
  ASSERT_TRUE(words.ok()) << words.status();
  EXPECT_THAT(*words, ElementsAre("plum-colored", "one"));
}

TEST(PiperStudy, KeepsResultsOfOtherOptionsApart) {
  const std::string out = Folder("options");
  PiperStudyLaunch launch;
  launch.out = out;
  launch.stages = {};
  PiperStudyOptions options = QuickPiperStudy();
  EXPECT_EQ(*RunPiperStudy(options, launch), 0);
  EXPECT_EQ(*RunPiperStudy(options, launch), 0);
  options.episodes = 10;
  EXPECT_EQ(RunPiperStudy(options, launch).status().code(), absl::StatusCode::kFailedPrecondition);
  launch.stages = {"celebrate"};
  options.episodes = QuickPiperStudy().episodes;
  EXPECT_THAT(std::string(RunPiperStudy(options, launch).status().message()),
              HasSubstr("evaluate"));
  launch.stages = {"evaluate"};
  EXPECT_THAT(std::string(RunPiperStudy(options, launch).status().message()),
              HasSubstr("record and train"));
}

}  // namespace
}  // namespace robostress
