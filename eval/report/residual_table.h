#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/statistics.h"
#include "eval/store/run_store.h"

// Residual magnitude across scenarios (paper, tab:residual-magnitude) and the share of it that is
// controller lag. Per rollout r, over its executed steps and without the gripper:
//
//   residual_r = ||eta||_2 / ||a||_2        eta = dx - a        (paper, Eq. eta-obs)
//   lag_r      = ||eta_lag||_2 / ||a||_2    eta_lag = dx_lag - a
//   added_r    = residual_r - lag_r
//   share_r    = lag_r / residual_r = ||eta_lag||_2 / ||eta||_2
//   tracking_r = ||dx / g - a||_2 / ||a||_2    g: the method's tracking_gain, a nominal arm's
//   steady
//                                              gain; beside the paper's reading, not instead of it
//
// where dx_lag is the motion that the rollout's commands as sent, played again open loop from the
// same initial state, make without joint errors. A table holds the means over rollouts.
namespace robostress {

// One scenario, or their average (strata: scenarios). All as fractions.
struct ResidualRow {
  std::string title;
  int n = 0;          // rollouts that moved: ||a|| > 0
  int successes = 0;  // of these
  BootstrapResult residual, lag, added, lag_share, tracking;
  std::optional<double> paper;  // tab:residual-magnitude, pi0, severity 5 [%]
};

// Rollouts of one goal reference, policy, method and suite.
struct ResidualTable {
  GoalReference goal_reference = GoalReference::kAchieved;
  std::string policy, method;
  std::string suites;  // titles: "Goal", "Spatial, Goal"
  int motionless = 0;  // rollouts without a command: they have no ratio
  std::vector<ResidualRow>
      rows;  // scenarios, then their average without Clean if there are several
};

// Tables in the order of the run's units; with several suites, all of them together come first.
// FailedPrecondition when an episode was recorded without its lag.
absl::StatusOr<std::vector<ResidualTable>> MakeResidualTables(const RunData& run,
                                                              int bootstrap_replicates);

// "Residual, goal reference achieved, policy nano, ..." of a table.
std::string ResidualHeading(const ResidualTable& table);
// Heading and rows in percent, for AlignedTable and MarkdownTable.
std::vector<std::vector<std::string>> ResidualCells(const ResidualTable& table);

// "achieved" or "desired", as in a configuration.
std::string GoalReferenceName(GoalReference reference);

}  // namespace robostress
