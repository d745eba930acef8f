#include "eval/report/result_comparison.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "nlohmann/json.hpp"
#include "tests/eval/shared_run.h"

namespace robostress {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Not;

// A run of base in two scenarios with errors and Clean; every k-th episode fails.
RunData Lab(int episodes, int k) {
  std::vector<int> outcomes;
  for (int i = 0; i < episodes; ++i) outcomes.push_back(i % k != 0);
  RunData run;
  for (const char* scenario : {"clean", "heavy_payload", "aged_joint_elbow"})
    run.units.push_back(SyntheticUnit(scenario, "base", outcomes));
  for (UnitResult& unit : run.units) unit.provenance = {{"model_hash", "m"}, {"version", "0.9"}};
  return run;
}

absl::StatusOr<ResultComparison> Compare(const RunData& first, const RunData& second) {
  return CompareResults({{"ours", Exported(first)}, {"theirs", Exported(second)}});
}

std::string Refused(const RunData& second) {
  const auto comparison = Compare(Lab(20, 2), second);
  return comparison.ok() ? absl::StrJoin(comparison->refused, "\n")
                         : std::string(comparison.status().message());
}

TEST(CompareResults, TakesLaboratoriesAsIndependentSamples) {
  const auto comparison = Compare(Lab(20, 2), Lab(50, 5));
  ASSERT_TRUE(comparison.ok()) << comparison.status();
  EXPECT_TRUE(comparison->refused.empty()) << absl::StrJoin(comparison->refused, "\n");
  ASSERT_EQ(comparison->rows.size(), 4u) << "three scenarios and the mean of two";
  const ResultRow& row = comparison->rows[1];
  EXPECT_EQ(row.scenario, "heavy_payload");
  const RateDifference expected = CompareRates({20, 10, 20, 1}, {50, 40, 50, 1});
  ASSERT_TRUE(row.differences[1].has_value());
  EXPECT_FALSE(row.differences[0].has_value()) << "the first is the reference";
  EXPECT_NEAR(row.differences[1]->estimate, 0.3, 1e-12);
  EXPECT_EQ(row.differences[1]->interval.low, expected.interval.low);
  EXPECT_EQ(row.differences[1]->p_value, expected.p_value);
  EXPECT_NEAR(row.p_holm[1], std::min(1.0, 3 * expected.p_value), 1e-12)
      << "over three rows; the mean has no p";
  const ResultRow& mean = comparison->rows[3];
  EXPECT_TRUE(mean.scenario.empty());
  EXPECT_NEAR(mean.differences[1]->estimate, 0.3, 1e-12);
  EXPECT_TRUE(std::isfinite(mean.differences[1]->interval.low));
  EXPECT_TRUE(std::isnan(mean.differences[1]->p_value));
}

TEST(CompareResults, AnswersToRepeatsByTheirDesignEffect) {
  RunData twice = Lab(20, 2);
  for (UnitResult unit : Lab(20, 2).units) {
    unit.config.seed = 1;
    twice.units.push_back(unit);
  }
  const auto once = Compare(Lab(20, 2), Lab(20, 5)), repeated = Compare(twice, Lab(20, 5));
  ASSERT_TRUE(once.ok() && repeated.ok());
  EXPECT_EQ(repeated->rows[0].cells[0]->counts.n, 40);
  EXPECT_NEAR(repeated->rows[0].differences[1]->interval.low,
              once->rows[0].differences[1]->interval.low, 0.01)
      << "the same outcomes again add nothing";
}

TEST(CompareResults, ATaskFileThatAnEarlierVersionDidNotNoteIsNoOther) {
  RunData other = Lab(20, 2);
  for (UnitResult& unit : other.units) unit.config.libero_tasks = "sha256 5a5a";
  EXPECT_EQ(Refused(other), "");
}

TEST(CompareResults, RefusesByNameWhatIsNotComparable) {
  RunData other = Lab(20, 2);
  for (UnitResult& unit : other.units) unit.config.severity = 3;
  EXPECT_THAT(Refused(other),
              HasSubstr("theirs, tabletop_goal, Heavy Payload L3, base: ours has no "
                        "such suite, scenario, severity and method"));
  EXPECT_THAT(Refused(other), HasSubstr("theirs lacks tabletop_goal, Heavy Payload L5, base"));
  other = Lab(20, 2);
  for (UnitResult& unit : other.units) unit.config.sim.stepping = Stepping::kParity;
  EXPECT_THAT(Refused(other), HasSubstr("no result is comparable"));
  EXPECT_THAT(Refused(other), HasSubstr("other protocol of tabletop_goal: sim.stepping (fast | "
                                        "parity)"));
  other = Lab(20, 2);
  for (UnitResult& unit : other.units) unit.config.method.Edit().gain = 1.1;
  EXPECT_THAT(Refused(other), HasSubstr("method base has other options"));
  other = Lab(20, 2);
  for (UnitResult& unit : other.units) unit.config.tasks = {3};
  EXPECT_THAT(Refused(other), HasSubstr("tasks (0 | 3)"));
}

TEST(CompareResults, RefusesAnotherVersionOfAScenarioAndKeepsTheOthers) {
  ResultFile theirs = Exported(Lab(20, 2));
  for (ResultScenario& scenario : theirs.scenarios)
    if (scenario.name == "heavy_payload") scenario.sha256 = std::string(64, '0');
  const auto comparison = CompareResults({{"ours", Exported(Lab(20, 2))}, {"theirs", theirs}});
  ASSERT_TRUE(comparison.ok()) << comparison.status();
  EXPECT_THAT(comparison->refused,
              Contains(HasSubstr("Heavy Payload L5, base: other version of scenario "
                                 "heavy_payload")));
  EXPECT_THAT(comparison->refused,
              Contains(HasSubstr("mean of 2 scenarios L5, base: other version")))
      << "a mean is of what it averages";
  ASSERT_EQ(comparison->rows.size(), 2u);
  EXPECT_EQ(comparison->rows[1].scenario, "aged_joint_elbow");
}

TEST(CompareResults, SaysWhatReadersMustKnow) {
  ResultFile theirs = Exported(Lab(20, 4));
  theirs.robostress = {"1.7"};
  theirs.policies[0].noise_paired = false;
  theirs.notes.push_back("A note of theirs.");
  const auto comparison = CompareResults({{"ours", Exported(Lab(20, 2))}, {"theirs", theirs}});
  ASSERT_TRUE(comparison.ok());
  const std::string notes = absl::StrJoin(comparison->notes, "\n");
  EXPECT_THAT(notes, HasSubstr("Versions differ: ours 0.9, theirs 1.7."));
  EXPECT_THAT(notes, HasSubstr("theirs: policy nano, model m, sampling noise not paired."));
  EXPECT_THAT(notes, HasSubstr("theirs: A note of theirs."));
}

TEST(CompareResults, ComparesNothingWithTheSameResults) {
  const NamedResults ours{"ours", Exported(Lab(20, 2))}, again{"again", ours.file},
      theirs{"theirs", Exported(Lab(20, 4))};
  const auto same = CompareResults({ours, again, theirs});
  ASSERT_TRUE(same.ok()) << same.status();
  EXPECT_THAT(same->notes, Contains(HasSubstr("again and ours are the same results: nothing")));
  for (const ResultRow& row : same->rows) {
    EXPECT_TRUE(row.cells[1].has_value());
    EXPECT_FALSE(row.differences[1].has_value());
    EXPECT_TRUE(row.differences[2].has_value());
  }
  const auto alone = CompareResults({ours, again});
  ASSERT_TRUE(alone.ok()) << alone.status();
  EXPECT_EQ(alone->rows.size(), 4u);
}

TEST(CompareResults, TakesSeveralFilesAndPoliciesAndNeedsTwo) {
  RunData two = Lab(20, 4);
  for (UnitResult unit : Lab(20, 5).units) {
    unit.config.policy = "other";
    two.units.push_back(unit);
  }
  const auto comparison = CompareResults(
      {{"ours", Exported(Lab(20, 2))}, {"theirs", Exported(two)}, {"third", Exported(Lab(30, 3))}});
  ASSERT_TRUE(comparison.ok()) << comparison.status();
  ASSERT_EQ(comparison->columns.size(), 4u);
  EXPECT_EQ(comparison->columns[1].name, "theirs: nano");
  EXPECT_EQ(comparison->columns[2].name, "theirs: other");
  EXPECT_NEAR(comparison->rows[0].differences[2]->estimate, 0.3, 1e-12);
  EXPECT_EQ(comparison->rows[0].cells[3]->counts.n, 30);
  EXPECT_THAT(std::string(CompareResults({{"ours", Exported(Lab(20, 2))}}).status().message()),
              HasSubstr("give a second file"));
}

TEST(CompareResults, RendersWithoutAnythingFromOutside) {
  ResultFile theirs = Exported(Lab(20, 4));
  theirs.notes.push_back("<script>alert(1)</script>");
  const auto comparison = CompareResults({{"<ours>", Exported(Lab(20, 2))}, {"lab-b", theirs}});
  ASSERT_TRUE(comparison.ok());
  const std::string page = ResultComparisonPage(*comparison);
  EXPECT_THAT(page, Not(HasSubstr("<script")));
  EXPECT_THAT(page, HasSubstr("&lt;ours&gt;"));
  EXPECT_THAT(page, HasSubstr("lab-b"));
  EXPECT_THAT(page, Not(::testing::ContainsRegex("nan[^o]")));
  const auto parsed = nlohmann::json::parse(ResultComparisonJson(*comparison), nullptr, false);
  ASSERT_TRUE(parsed.is_object());
  EXPECT_EQ(parsed["rows"][0]["cells"][1]["n"], 20);
  EXPECT_TRUE(parsed["rows"][3]["cells"][1]["p"].is_null());
  const TextRows rows = ResultCells(*comparison);
  EXPECT_THAT(rows[2], Contains("+25.0 [-4.7, +49.4]"));
}

}  // namespace
}  // namespace robostress
