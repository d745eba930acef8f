#include "eval/report/store_comparison.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "eval/plan/plan.h"
#include "eval/report/text_table.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

RunData Store(const std::string& dir, const std::vector<int>& payload,
              const std::vector<int>& elbow) {
  RunData run;
  run.dir = dir;
  run.units = {SyntheticUnit("heavy_payload", "base", payload),
               SyntheticUnit("aged_joint_elbow", "base", elbow)};
  return run;
}

std::string NotesOf(const StoreComparison& comparison) {
  return absl::StrJoin(comparison.notes, "\n");
}

TEST(CompareStores, PairsEpisodesOfEqualStateAndSeed) {
  const auto comparison = CompareStores(Store("a", {0, 0, 1, 0}, {1, 1, 1, 0}),
                                        Store("b", {1, 1, 0, 0}, {1, 1, 1, 1}), 200);
  ASSERT_TRUE(comparison.ok()) << comparison.status();
  ASSERT_EQ(comparison->rows.size(), 3u);
  const StoreRow& payload = comparison->rows[0];
  EXPECT_EQ(payload.title, "Heavy Payload");
  ASSERT_TRUE(payload.paired.has_value());
  EXPECT_EQ(payload.paired->plus, 2);
  EXPECT_EQ(payload.paired->minus, 1);
  EXPECT_NEAR(payload.difference.estimate, 0.25, 1e-12);
  EXPECT_EQ(payload.first, 0.25);
  const StoreRow& average = comparison->rows[2];
  EXPECT_EQ(average.scenario, "");
  EXPECT_NEAR(average.difference.estimate, 0.25, 1e-12);
  EXPECT_TRUE(comparison->notes.empty()) << NotesOf(*comparison);
  EXPECT_THAT(StoreCells(*comparison)[1], ::testing::Contains("+2/-1 of 4"));
}

TEST(CompareStores, ResamplesApartWhatDoesNotPairAndSaysSo) {
  RunData second = Store("b", {1, 1, 1, 0}, {1, 1, 1, 1});
  for (UnitResult& unit : second.units) {
    for (EpisodeRow& row : unit.episodes) row.initial_state += 20;
  }
  const auto comparison = CompareStores(Store("a", {0, 0, 1, 0}, {1, 1, 1, 0}), second, 500);
  ASSERT_TRUE(comparison.ok()) << comparison.status();
  ASSERT_EQ(comparison->rows.size(), 2u) << "nothing pairs, so there is no paired average";
  const StoreRow& payload = comparison->rows[0];
  EXPECT_FALSE(payload.paired.has_value());
  EXPECT_NEAR(payload.difference.estimate, 0.5, 1e-12);
  EXPECT_LT(payload.difference.interval.low, 0.5);
  EXPECT_GT(payload.difference.interval.high, 0.5);
  EXPECT_THAT(StoreCells(*comparison)[1], ::testing::Contains("not paired"));
  EXPECT_THAT(StorePage(*comparison), HasSubstr("not paired"));
}

TEST(CompareStores, UnpairedIntervalIsThatOfTheNormalLimit) {
  // 400 episodes each at 50 % and 75 %: the half width is 1.96 sqrt(pq/n + pq/n). Monte-Carlo error
  // of the ends over 4000 replicates is about 4 % of it.
  std::vector<int> half, more;
  for (int i = 0; i < 400; ++i) {
    half.push_back(i % 2);
    more.push_back(i % 4 != 0);
  }
  RunData a, b;
  a.units = {SyntheticUnit("heavy_payload", "base", half)};
  b.units = {SyntheticUnit("heavy_payload", "base", more)};
  b.units[0].config.seed = 1;
  const auto comparison = CompareStores(a, b, 4000);
  ASSERT_TRUE(comparison.ok());
  const double width = 1.96 * std::sqrt(0.25 / 400 + 0.1875 / 400);
  EXPECT_NEAR(comparison->rows[0].difference.interval.low, 0.25 - width, 0.15 * width);
  EXPECT_NEAR(comparison->rows[0].difference.interval.high, 0.25 + width, 0.15 * width);
}

TEST(CompareStores, SaysWhatIsInOneStoreAloneAndWhatIsOtherwiseDifferent) {
  RunData first = Store("a", {0, 1}, {1, 1}), second = Store("b", {1, 1}, {1, 1});
  first.units.push_back(SyntheticUnit("heavy_payload", "ours", {1, 1}));
  first.units[0].provenance = {{"model_hash", "aaaa"}};
  second.units[0].provenance = {{"model_hash", "bbbb"}};
  second.units[1].config.method.Edit().gain = 1.5;
  const auto comparison = CompareStores(first, second, 100);
  ASSERT_TRUE(comparison.ok());
  const std::string notes = NotesOf(*comparison);
  EXPECT_THAT(notes, HasSubstr("tabletop_goal-heavy_payload-L5-nano-ours-s0"));
  EXPECT_THAT(notes, HasSubstr("nano (aaaa | bbbb)"));
  EXPECT_THAT(notes, HasSubstr("gain: 1.5"));
}

TEST(CompareStores, CleanThatWasPlayedAtTwoLevelsCountsOnce) {
  RunData first, second;
  first.units = {SyntheticUnit("clean", "base", {0, 1}), SyntheticUnit("clean", "base", {0, 1})};
  first.units[0].config.severity = 3;
  second.units = {SyntheticUnit("clean", "base", {1, 1})};
  for (const bool turned : {false, true}) {
    const auto comparison =
        turned ? CompareStores(second, first, 50) : CompareStores(first, second, 50);
    ASSERT_TRUE(comparison.ok()) << comparison.status();
    ASSERT_EQ(comparison->rows.size(), 1u);
    EXPECT_EQ(comparison->rows[0].n_first, 2);
    EXPECT_EQ(comparison->rows[0].n_second, 2);
    EXPECT_EQ(comparison->rows[0].paired->pairs, 2);
  }
}

TEST(CompareStores, AFileOfOneNameThatHoldsAnotherScenarioIsNotCompared) {
  const std::string folder = TestFolder();
  const auto worn = [&](const std::string& name, const std::string& delay_s) {
    const std::string file = folder + "/" + name + "/worn.yaml";
    EXPECT_TRUE(MakeDirectories(folder + "/" + name).ok());
    EXPECT_TRUE(WriteFileAtomically(file,
                                    "joints: [{name: J4, effects: [{type: transport_delay, "
                                    "delay_s: " +
                                        delay_s + "}]}]\n")
                    .ok());
    return file;
  };
  RunData first = Store("a", {0, 1}, {1, 1}), second = Store("b", {1, 1}, {1, 1});
  first.units.push_back(SyntheticUnit(worn("a", "0.02"), "base", {0, 1}));
  second.units.push_back(SyntheticUnit(worn("b", "0.02"), "base", {1, 1}));
  for (RunData* run : {&first, &second}) run->units.back().id = UnitId(run->units.back().config);
  EXPECT_EQ(CompareStores(first, second, 50)->rows.size(), 4u) << "where a file lies is nothing";
  EXPECT_EQ(NotesOf(*CompareStores(first, second, 50)), "");
  worn("b", "0.04");
  const auto comparison = CompareStores(first, second, 50);
  EXPECT_EQ(comparison->rows.size(), 3u);
  EXPECT_THAT(NotesOf(*comparison), HasSubstr("Not compared, because the file holds another "
                                              "scenario in the second: worn."));
  first.units.erase(first.units.begin(), first.units.begin() + 2);
  EXPECT_THAT(
      std::string(CompareStores(first, second, 50).status().message()),
      HasSubstr("and a task of a suite); nothing can be compared. Not compared, because the "
                "file"));
}

TEST(CompareStores, StoresWithoutACommonCellAreRefused) {
  RunData first, second;
  first.dir = "a", second.dir = "b";
  first.units = {SyntheticUnit("heavy_payload", "base", {1})};
  second.units = {SyntheticUnit("heavy_payload", "ours", {1})};
  EXPECT_THAT(std::string(CompareStores(first, second, 10).status().message()),
              HasSubstr("a and b have no cell in common"));
}

TEST(CompareStores, RatesOverOtherTasksAreNoComparison) {
  const RunData first = Store("a", {0, 0, 1, 0}, {1, 1, 1, 0});
  RunData other = Store("b", {1, 1, 1, 1}, {1, 1, 1, 1});
  for (UnitResult& unit : other.units) unit.config.suite = "tabletop_long";
  EXPECT_THAT(std::string(CompareStores(first, other, 10).status().message()),
              HasSubstr("no cell in common"));
  RunData both = Store("b", {1, 1, 1, 1}, {1, 1, 1, 1});  // the first suite and another
  for (const UnitResult& unit : other.units) both.units.push_back(unit);
  for (UnitResult& unit : both.units) {  // and one episode of another task
    unit.episodes[0].task += 100;
    unit.episodes[0].success = false;
  }
  const auto comparison = CompareStores(first, both, 10);
  ASSERT_TRUE(comparison.ok()) << comparison.status();
  const StoreRow& payload = comparison->rows[0];
  ASSERT_TRUE(payload.paired.has_value());
  EXPECT_EQ(payload.paired->pairs, 3);
  EXPECT_EQ(payload.n_second, 3) << "neither the other suite's four nor the other task's";
  EXPECT_EQ(payload.second, 1);
  EXPECT_EQ(payload.n_first, 4);
  EXPECT_THAT(NotesOf(*comparison), HasSubstr("episodes are of suites or tasks that the other"));
}

TEST(CompareStores, RendersWithoutAnythingFromOutside) {
  const auto comparison =
      CompareStores(Store("<a>", {0, 1}, {1, 1}), Store("b", {1, 1}, {1, 1}), 50);
  ASSERT_TRUE(comparison.ok());
  const std::string page = StorePage(*comparison);
  EXPECT_THAT(page, HasSubstr("&lt;a&gt;"));
  EXPECT_THAT(page, Not(HasSubstr("<script")));
  EXPECT_THAT(page, Not(::testing::ContainsRegex("nan[^o]")));
  EXPECT_TRUE(nlohmann::json::parse(StoreJson(*comparison), nullptr, false).is_object());
  const std::string csv = CsvTable(StoreCells(*comparison));
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + 3);
  EXPECT_THAT(csv, HasSubstr("\"+50.0 ["));
}

}  // namespace
}  // namespace robostress
