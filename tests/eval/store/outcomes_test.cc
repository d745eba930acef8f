#include "eval/store/outcomes.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "eval/paper/paper_results.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

UnitResult Unit(const std::string& scenario, const std::string& method,
                const std::vector<int>& outcomes) {
  UnitResult unit = SyntheticUnit(scenario, method, outcomes);
  unit.provenance = {{"model_hash", "0123456789abcdef"}, {"version", "1.0"}};
  unit.machines = {"Processor X, avx2"};
  return unit;
}

RunData Finished() {
  RunData run;
  run.units = {Unit("clean", "base", {1, 1, 0, 1}), Unit("clean", "ours", {0, 1, 1, 1}),
               Unit("heavy_payload", "base", {0, 0, 0, 1})};
  run.units[1].episodes.back().updates = 7;
  return run;
}

std::string Written(const std::string& name, const std::string& text) {
  const std::string file = ::testing::TempDir() + "robostress_outcomes_" + name;
  EXPECT_TRUE(WriteFileAtomically(file, text).ok());
  return file;
}

std::string Refusal(const std::vector<std::string>& files) {
  return std::string(ReadOutcomes(files).status().message());
}

TEST(Outcomes, ComeBackAsTheyWere) {
  const std::string text = *OutcomesText(Finished());
  const auto read = ReadOutcomes({Written("a.jsonl", text)});
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_THAT(read->notes, IsEmpty());
  ASSERT_EQ(read->run.units.size(), 3u);
  const UnitResult& ours = read->run.units[1];
  EXPECT_EQ(ours.id, "tabletop_goal-clean-L5-nano-ours-s0");
  EXPECT_TRUE(ours.config.method->adapts()) << "a preset's options come with its name";
  EXPECT_EQ(ours.episodes.back().updates, 7);
  ASSERT_EQ(ours.episodes.size(), 4u);
  EXPECT_FALSE(ours.episodes[0].success);
  EXPECT_TRUE(ours.episodes[3].success);
  EXPECT_EQ(ours.episodes[3].initial_state, 3);
  EXPECT_FALSE(ours.episodes[3].residual.has_value());
}

TEST(Outcomes, CallAPolicyByItsLabelAndReadOlderIds) {
  RunData run = Finished();
  run.units.resize(1);
  run.units[0].config.policy = "checkpoints/pi0.5";
  const std::string text = *OutcomesText(run);
  const std::string older = absl::StrReplaceAll(text, {{"L5-pi0.5-base", "L5-pi0-base"}});
  EXPECT_NE(text, older);
  for (const std::string& written : {text, older}) {
    const auto read = ReadOutcomes({Written("pi05.jsonl", written)});
    ASSERT_TRUE(read.ok()) << read.status();
    EXPECT_EQ(read->run.units[0].id, "tabletop_goal-clean-L5-pi0.5-base-s0");
    EXPECT_EQ(read->run.units[0].config.policy, "pi0.5");
  }
}

TEST(Outcomes, SayWhereSamplingNoiseIsNotPaired) {
  RunData run = Finished();
  run.units[0].config.remote.dialect.name = "libero";
  const auto read = ReadOutcomes({Written("unpaired.jsonl", *OutcomesText(run))});
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_FALSE(PairsNoise(read->run.units[0].config));
  EXPECT_TRUE(PairsNoise(read->run.units[1].config));
  EXPECT_THAT(UnpairedNoiseNote(read->run), HasSubstr("Sampling noise not paired"));
}

TEST(Outcomes, EpisodesAreOfTheInitialStatesThatTheirUnitBeganAt) {
  RunData run = Finished();
  run.units.resize(1);
  run.units[0].config.first_initial_state = 40;
  const auto read = ReadOutcomes({Written("dev.jsonl", *OutcomesText(run))});
  ASSERT_TRUE(read.ok()) << read.status();
  const std::vector<EpisodeRow>& episodes = read->run.units[0].episodes;
  ASSERT_EQ(episodes.size(), 4u);
  for (int i = 0; i < 4; ++i) EXPECT_EQ(episodes[static_cast<size_t>(i)].initial_state, 40 + i);
}

TEST(Outcomes, AUnitInTwoFilesCountsOnceAndOrderDoesNotMatter) {
  RunData first = Finished(), second = Finished();
  first.units.pop_back();
  second.units.erase(second.units.begin());
  std::reverse(second.units.begin(), second.units.end());
  const std::string a = Written("a.jsonl", *OutcomesText(first)),
                    b = Written("b.jsonl", *OutcomesText(second));
  for (const auto& files : {std::vector{a, b}, std::vector{b, a}}) {
    const auto read = ReadOutcomes(files);
    ASSERT_TRUE(read.ok()) << read.status();
    std::vector<std::string> ids;
    for (const UnitResult& unit : read->run.units) ids.push_back(unit.id);
    EXPECT_THAT(ids, ElementsAre("tabletop_goal-clean-L5-nano-base-s0",
                                 "tabletop_goal-clean-L5-nano-ours-s0",
                                 "tabletop_goal-heavy_payload-L5-nano-base-s0"));
  }
}

TEST(Outcomes, EverythingThatIsWrongIsListed) {
  const std::string text = *OutcomesText(Finished());
  const std::string good = Written("good.jsonl", text);
  const std::string other = Written(
      "other.jsonl",
      absl::StrReplaceAll(text, {{"[\"1101\"]", "[\"1111\"]"}, {"[\"0111\"]", "[\"01x1\"]"}}));
  const std::string refusal = Refusal({good, other, ::testing::TempDir() + "none.jsonl"});
  EXPECT_THAT(refusal, HasSubstr("tabletop_goal-clean-L5-nano-base-s0 stands in"));
  EXPECT_THAT(refusal,
              HasSubstr("other.jsonl:2: field outcomes holds '01x1', must be 4 of 0 and 1"));
  EXPECT_THAT(refusal, HasSubstr("none.jsonl"));
  EXPECT_THAT(Refusal({Written("text.jsonl", "hello\n")}), HasSubstr("text.jsonl:1: not a JSON"));
  EXPECT_THAT(Refusal({Written("field.jsonl", absl::StrReplaceAll(text, {{"seed", "sead"}}))}),
              HasSubstr("'seed' not found"));
  EXPECT_THAT(
      Refusal({Written("name.jsonl", absl::StrReplaceAll(text, {{"-s0", "-s1"}}))}),
      HasSubstr("name.jsonl:1: field unit is 'tabletop_goal-clean-L5-nano-base-s1', but its "
                "other fields are those of tabletop_goal-clean-L5-nano-base-s0"));
  EXPECT_THAT(
      Refusal({Written("method.jsonl", absl::StrReplaceAll(text, {{"\"ours\"", "\"hours\""}}))}),
      HasSubstr("unknown method 'hours'"));
}

TEST(Outcomes, OneWeightsPerPolicyAndSeveralVersionsAreSaid) {
  RunData later = Finished();
  for (UnitResult& unit : later.units) {
    unit.id = absl::StrReplaceAll(unit.id, {{"-s0", "-s1"}});
    unit.config.seed = 1;
    unit.provenance["version"] = "1.1";
    unit.machines = {"Processor Y"};
  }
  const std::string first = Written("a.jsonl", *OutcomesText(Finished()));
  const auto read = ReadOutcomes({first, Written("b.jsonl", *OutcomesText(later))});
  ASSERT_TRUE(read.ok()) << read.status();
  ASSERT_EQ(read->notes.size(), 2u);
  EXPECT_THAT(read->notes[0], HasSubstr("1.0 (3 units), 1.1 (3 units)"));
  EXPECT_THAT(read->notes[1], HasSubstr("mixes kinds of processors"));
  for (UnitResult& unit : later.units) unit.provenance["model_hash"] = "fedcba9876543210";
  EXPECT_THAT(Refusal({first, Written("c.jsonl", *OutcomesText(later))}),
              HasSubstr("policy nano has weights"));
}

std::vector<PlannedUnit> QuickUnits(const PaperTable& table) {
  return *PaperUnits(*PaperGrids(table, QuickProtocol(), PolicyHome::kHere));
}

// Finished units with outcomes in an order of no meaning.
RunData Played(const std::vector<PlannedUnit>& planned) {
  RunData run;
  int draw = 0;
  for (const PlannedUnit& unit : planned) {
    UnitResult result;
    result.id = unit.id;
    result.config = unit.config;
    for (const int task : unit.config.tasks) {
      for (int i = 0; i < unit.config.episodes; ++i) {
        EpisodeRow row;
        row.task = task;
        row.episode = row.initial_state = i;
        draw = (draw * 5 + 3) % 64;
        row.success = draw % 3 == 0;
        result.episodes.push_back(row);
      }
    }
    run.units.push_back(result);
  }
  return run;
}

TEST(Outcomes, FillAPapersTableLikeTheRunItself) {
  const PaperTable table = *FindPaperTable("main");
  const std::vector<PlannedUnit> planned = QuickUnits(table);
  const RunData run = Played(planned);
  auto read = ReadOutcomes({Written("main.jsonl", *OutcomesText(run))});
  ASSERT_TRUE(read.ok()) << read.status();
  EXPECT_THAT(HoldAgainstPlan(planned, read->run), IsEmpty());
  EXPECT_EQ(FilledText(FillPaperTable(table, QuickProtocol(), read->run, planned, 50)),
            FilledText(FillPaperTable(table, QuickProtocol(), run, planned, 50)));
}

TEST(Outcomes, OtherOptionsAreSaidAndOtherEpisodesLeftOut) {
  std::vector<PlannedUnit> planned = QuickUnits(*FindPaperTable("anchor"));
  const std::string file = Written("anchor.jsonl", *OutcomesText(Played(planned)));
  planned[0].config.method.Edit().tracking_gain *= 2;
  planned[1].config.first_initial_state = 40;
  RunData run = ReadOutcomes({file})->run;
  const std::vector<std::string> notes = HoldAgainstPlan(planned, run);
  ASSERT_EQ(notes.size(), 2u);
  EXPECT_THAT(notes[0], HasSubstr("in units of: " + planned[0].config.method->method));
  EXPECT_THAT(notes[1], HasSubstr("1 units cover other episodes"));
  EXPECT_EQ(run.units.size(), planned.size() - 1);
}

TEST(Outcomes, AUnitThatLacksEpisodesIsRefused) {
  RunData run = Finished();
  run.units[0].episodes.pop_back();
  EXPECT_THAT(std::string(OutcomesText(run).status().message()), HasSubstr("lacks episodes"));
}

}  // namespace
}  // namespace robostress
