#include "eval/report/residual_table.h"

#include <cmath>

#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

struct Ratios {
  double residual, lag;
};

// Successful rollouts with ||a|| = 2 and the ratios given.
UnitResult UnitWith(const std::string& scenario, const std::vector<Ratios>& ratios,
                    const std::string& suite = "tabletop_goal") {
  UnitResult unit = SyntheticUnit(scenario, "base", std::vector<int>(ratios.size(), 1), {}, suite);
  for (size_t i = 0; i < ratios.size(); ++i) {
    unit.episodes[i].a_sq = 4;
    unit.episodes[i].residual = ratios[i].residual;
    unit.episodes[i].lag_residual = ratios[i].lag;
    unit.episodes[i].residual_tracking = ratios[i].residual / 2;
  }
  return unit;
}

std::vector<ResidualTable> Tables(const std::vector<UnitResult>& units) {
  RunData run;
  run.units = units;
  const absl::StatusOr<std::vector<ResidualTable>> tables = MakeResidualTables(run, 500);
  EXPECT_TRUE(tables.ok()) << tables.status();
  return tables.value_or(std::vector<ResidualTable>());
}

TEST(ResidualTable, AveragesOverRollouts) {
  const auto tables = Tables({UnitWith("heavy_payload", {{0.8, 0.6}, {0.4, 0.1}})});
  ASSERT_EQ(tables.size(), 1u);
  ASSERT_EQ(tables[0].rows.size(), 1u) << "one scenario has no average";
  const ResidualRow& row = tables[0].rows[0];
  EXPECT_EQ(row.n, 2);
  EXPECT_EQ(row.successes, 2);
  EXPECT_NEAR(row.residual.estimate, 0.6, 1e-12);
  EXPECT_NEAR(row.lag.estimate, 0.35, 1e-12);
  EXPECT_NEAR(row.added.estimate, 0.25, 1e-12);
  // The mean of the rollouts' shares, 0.75 and 0.25, not the share of the means, 0.58.
  EXPECT_NEAR(row.lag_share.estimate, 0.5, 1e-12);
  // Two episodes drawn twice: half of the replicates are one of them alone.
  EXPECT_NEAR(row.residual.interval.low, 0.4, 1e-12);
  EXPECT_NEAR(row.residual.interval.high, 0.8, 1e-12);
}

TEST(ResidualTable, PaperStandsBesideItsOwnSeverityOnly) {
  UnitResult mild = UnitWith("heavy_payload", {{0.7, 0.6}});
  mild.config.severity = 3;
  UnitResult clean = UnitWith("clean", {{0.6, 0.6}});
  clean.config.severity = 3;  // a scenario that is equal at all levels is planned once
  const auto tables = Tables({clean, mild, UnitWith("heavy_payload", {{0.8, 0.6}})});
  const std::vector<ResidualRow>& rows = tables.at(0).rows;
  ASSERT_EQ(rows.size(), 4u);
  EXPECT_EQ(rows[0].title, "Clean");
  EXPECT_EQ(rows[0].paper, 23.4);
  EXPECT_EQ(rows[1].title, "Heavy Payload L3");
  EXPECT_FALSE(rows[1].paper.has_value());
  EXPECT_EQ(rows[2].title, "Heavy Payload");
  EXPECT_EQ(rows[2].paper, 48.6);
  EXPECT_FALSE(rows[3].paper.has_value()) << "not the paper's average: not its scenarios";
}

TEST(ResidualTable, AverageLeavesCleanOutAndWeighsScenariosEqually) {
  const auto tables =
      Tables({UnitWith("clean", {{0.1, 0.1}}), UnitWith("heavy_payload", {{0.8, 0.4}, {0.6, 0.3}}),
              UnitWith("aged_joint_elbow", {{0.9, 0.9}})});
  const ResidualRow& average = tables.at(0).rows.back();
  EXPECT_EQ(average.title, "Average without Clean");
  EXPECT_EQ(average.n, 3);
  EXPECT_NEAR(average.residual.estimate, (0.7 + 0.9) / 2, 1e-12);
  EXPECT_NEAR(average.lag_share.estimate, (0.5 + 1.0) / 2, 1e-12);
}

TEST(ResidualTable, GoalReferencesAndSuitesHaveTablesOfTheirOwn) {
  UnitResult desired = UnitWith("clean", {{2.0, 1.9}});
  desired.config.sim.goal_reference = GoalReference::kDesired;
  const auto tables = Tables({UnitWith("clean", {{0.7, 0.7}}, "tabletop_spatial"),
                              UnitWith("clean", {{0.5, 0.5}}), desired});
  ASSERT_EQ(tables.size(), 4u);
  EXPECT_EQ(tables[0].suites, "Spatial, Goal");
  EXPECT_NEAR(tables[0].rows[0].residual.estimate, 0.6, 1e-12);
  EXPECT_EQ(tables[1].suites, "Spatial");
  EXPECT_EQ(tables[2].suites, "Goal");
  EXPECT_EQ(tables[3].goal_reference, GoalReference::kDesired);
  EXPECT_THAT(ResidualHeading(tables[3]), HasSubstr("goal reference desired, policy nano"));
}

TEST(ResidualTable, RolloutsWithoutACommandHaveNoRatioAndAreCounted) {
  UnitResult unit = UnitWith("clean", {{0.5, 0.5}, {0, 0}});
  unit.episodes[1].a_sq = 0;
  const auto tables = Tables({unit});
  EXPECT_EQ(tables.at(0).motionless, 1);
  EXPECT_EQ(tables[0].rows[0].n, 1);
  EXPECT_TRUE(std::isnan(tables[0].rows[0].residual.interval.low)) << "one episode, no interval";
  EXPECT_THAT(ResidualHeading(tables[0]), HasSubstr("without 1 rollouts"));
}

TEST(ResidualTable, EpisodeWithoutItsLagIsRefusedByName) {
  RunData run;
  run.units = {UnitWith("clean", {{0.5, 0.5}})};
  run.units[0].episodes[0].lag_residual.reset();
  const absl::Status status = MakeResidualTables(run, 10).status();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()),
              ::testing::AllOf(HasSubstr(run.units[0].id), HasSubstr("lag_residual"),
                               HasSubstr("choose another --out")));
}

TEST(ResidualTable, CellsArePercentAndPoints) {
  const auto tables = Tables({UnitWith("heavy_payload", {{0.8, 0.6}, {0.4, 0.1}})});
  EXPECT_THAT(ResidualCells(tables.at(0)).at(1),
              ::testing::ElementsAre("Heavy Payload", "2", "100", "60.0 [40.0, 80.0]",
                                     "35.0 [10.0, 60.0]", "+25.0 [+20.0, +30.0]",
                                     "50.0 [25.0, 75.0]", "30.0 [20.0, 40.0]", "48.6"));
}

}  // namespace
}  // namespace robostress
