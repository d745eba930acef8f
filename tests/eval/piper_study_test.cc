#include "eval/piper_study/piper_study.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <set>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/records/arm_episode.h"
#include "common/safetensors.h"
#include "eval/piper_study/piper_study_live.h"
#include "eval/piper_study/piper_study_report.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

std::string Folder(const std::string& name) {
  const std::string folder = ::testing::TempDir() + "/piper_study_" + name;
  std::filesystem::remove_all(folder);
  EXPECT_TRUE(MakeDirectories(folder).ok());
  return folder;
}

TEST(PiperStudyPlan, HoldsEveryCellOfThePapersTablesOnce) {
  const auto units = PlanPiperStudy({});
  ASSERT_TRUE(units.ok()) << units.status();
  std::set<std::string> ids;
  for (const PiperUnit& unit : *units) ids.insert(unit.id);
  EXPECT_EQ(ids.size(), units->size());
  EXPECT_EQ(units->size(), 2u * 4 * 3 + 2 + 3);
  for (const char* id : {"main_new_1_base", "main_used_one_year_4_robust", "dob_new_1_dob",
                         "dob_new_1_dob_ours", "unseen_new_1_ours"})
    EXPECT_TRUE(ids.count(id)) << id;
}

TEST(PiperStudyPlan, TheObserverAloneBringsWhatItIsComparedWith) {
  PiperStudyOptions options;
  options.experiments = {"dob"};
  const auto units = PlanPiperStudy(options);
  ASSERT_TRUE(units.ok()) << units.status();
  std::vector<std::string> ids;
  for (const PiperUnit& unit : *units) ids.push_back(unit.id);
  EXPECT_THAT(ids, ElementsAre("main_new_1_base", "main_new_1_ours", "dob_new_1_dob",
                               "dob_new_1_dob_ours"));
}

TEST(PiperStudyPlan, AUnitSaysEverythingThatDecidesIt) {
  PiperStudyOptions options;
  options.overrides = {"learning_rate=3e-5"};
  const PiperUnit unit{"unseen_new_1_ours", "unseen", "new", 1, "ours"};
  const auto yaml = PiperUnitYaml(options, unit, "w.safetensors");
  ASSERT_TRUE(yaml.ok()) << yaml.status();
  EXPECT_THAT(*yaml, AllOf(HasSubstr("task: bowl_next_to_plate\n"),
                           HasSubstr("variants: [wooden, plum, light_blue, yellow_plate, "
                                     "green_plate]\n"),
                           HasSubstr("episodes: 25\n"), HasSubstr("observer: false\n"),
                           HasSubstr("policy: \"w.safetensors\"\n"), HasSubstr("\n  adapt: true\n"),
                           HasSubstr("learning_rate: 3")));
  const auto dob = PiperUnitYaml(options, {"dob_new_1_dob", "dob", "new", 1, "dob"}, "w");
  ASSERT_TRUE(dob.ok()) << dob.status();
  EXPECT_THAT(*dob, AllOf(HasSubstr("observer: true\n"), HasSubstr("\n  adapt: false\n"),
                          HasSubstr("variants: [gray]\n")));
}

TEST(PiperStudyPlan, NamesFieldValueAndRemedyOfWhatIsWrong) {
  const auto refused = [](const std::function<void(PiperStudyOptions&)>& change) {
    PiperStudyOptions options;
    change(options);
    return std::string(PlanPiperStudy(options).status().message());
  };
  EXPECT_THAT(refused([](auto& o) { o.tasks = {5}; }), AllOf(HasSubstr("5"), HasSubstr("1 to 4")));
  EXPECT_THAT(refused([](auto& o) { o.experiments = {"sabotage"}; }), HasSubstr("unseen"));
  EXPECT_THAT(refused([](auto& o) { o.episodes = 7; }), HasSubstr("multiple of 5"));
  EXPECT_THAT(refused([](auto& o) { o.base_weights = "b"; }), HasSubstr("robust_weights"));
  EXPECT_THAT(refused([](auto& o) { o.overrides = {"learning=1"}; }), HasSubstr("learning_rate"));
  EXPECT_THAT(refused([](auto& o) { o.arms = {}; }), HasSubstr("arms"));
}

// A finished unit whose episode i succeeded where `successes` has a 1.
void WriteUnit(const std::string& out, const std::string& id, const std::string& successes,
               int updates, const std::string& variant = "gray") {
  const std::string folder = out + "/units/" + id;
  ASSERT_TRUE(MakeDirectories(folder).ok());
  for (size_t i = 0; i < successes.size(); ++i) {
    ArmEpisode row;
    row.episode = static_cast<int>(i);
    row.variant = variant;
    row.instruction = "pick up the wooden bowl";
    row.success = successes[i] == '1';
    row.residual = 0.25;
    row.adapter_version = static_cast<uint64_t>(updates);
    row.steps = 100;
    row.steps_masked = 3;
    ASSERT_TRUE(AppendLine(folder + "/episodes.jsonl", ArmEpisodeLine(row)).ok());
  }
  ASSERT_TRUE(WriteFileAtomically(folder + "/DONE", "").ok());
}

TEST(PiperStudyReport, ComparesMethodsOnTheSameInitialStates) {
  const std::string out = Folder("report");
  PiperStudyOptions options;
  options.arms = {"new"};
  options.tasks = {1};
  const auto units = PlanPiperStudy(options);
  ASSERT_TRUE(units.ok()) << units.status();
  WriteUnit(out, "main_new_1_base", "1100010000", 0);
  WriteUnit(out, "main_new_1_ours", "1110110000", 9);
  const auto episodes = ReadPiperStudy(*units, out + "/units");
  ASSERT_TRUE(episodes.ok()) << episodes.status();
  const PiperCell ours = MakePiperCell(*episodes, "ours", "x");
  EXPECT_EQ(ours.n, 10);
  EXPECT_EQ(ours.successes, 5);
  EXPECT_EQ(ours.updates, 9);
  EXPECT_EQ(ours.plus, 2);
  EXPECT_EQ(ours.minus, 0);
  EXPECT_NEAR(ours.versus_base.estimate, 0.2, 1e-12);
  EXPECT_NEAR(ours.wilson.low, WilsonInterval(5, 10).low, 1e-12);
  EXPECT_FALSE(MakePiperCell(*episodes, "base", "x").paired);
  EXPECT_EQ(MakePiperCell(*episodes, "robust", "x").n, 0);

  ASSERT_TRUE(WritePiperReport(options, *units, out, "units", out + "/none").ok());
  const auto csv = ReadFile(out + "/episodes.csv"), page = ReadFile(out + "/report.md");
  ASSERT_TRUE(csv.ok() && page.ok());
  EXPECT_THAT(*csv, HasSubstr("new,nano,ours,1,0,2,1,0.250000,9,100,3,0,main\n"));
  EXPECT_THAT(*page, AllOf(HasSubstr("2 of 8 units"), HasSubstr("5/10"), HasSubstr("+20")));
  const std::string first = *csv;
  ASSERT_TRUE(WritePiperReport(options, *units, out, "units", out + "/none").ok());
  EXPECT_EQ(*ReadFile(out + "/episodes.csv"), first);
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

TEST(PiperStudyReport, RefusesDamagedRows) {
  const std::string out = Folder("damaged");
  const auto units = PlanPiperStudy({});
  ASSERT_TRUE(units.ok());
  EXPECT_EQ(WritePiperReport({}, *units, out, "units", "").code(), absl::StatusCode::kNotFound);
  WriteUnit(out, "main_new_1_base", "1", 0);
  ASSERT_TRUE(AppendLine(out + "/units/main_new_1_base/episodes.jsonl", "{\"episode\":1").ok());
  EXPECT_THAT(std::string(ReadPiperStudy(*units, out + "/units").status().message()),
              HasSubstr("episodes.jsonl:2"));
}

TEST(PiperStudy, KeepsResultsOfOtherOptionsApart) {
  const std::string out = Folder("options");
  PiperStudyLaunch launch;
  launch.out = out;
  launch.stages = {};
  PiperStudyOptions options = QuickPiperStudy();
  EXPECT_TRUE(RunPiperStudy(options, launch).ok());
  EXPECT_TRUE(RunPiperStudy(options, launch).ok());
  options.episodes = 10;
  EXPECT_EQ(RunPiperStudy(options, launch).code(), absl::StatusCode::kFailedPrecondition);
  launch.stages = {"celebrate"};
  options.episodes = QuickPiperStudy().episodes;
  EXPECT_THAT(std::string(RunPiperStudy(options, launch).message()), HasSubstr("evaluate"));
  launch.stages = {"evaluate"};
  EXPECT_THAT(std::string(RunPiperStudy(options, launch).message()), HasSubstr("record and train"));
}

TEST(PiperStudy, LeavesTheObjectVariantsToSimulatedTime) {
  PiperStudyLaunch launch;
  launch.out = Folder("live");
  EXPECT_EQ(
      RunLiveUnit({}, {"unseen_new_1_ours", "unseen", "new", 1, "ours"}, "w", "s", launch).code(),
      absl::StatusCode::kUnimplemented);
}

}  // namespace
}  // namespace robostress
