#pragma once

#include <optional>
#include <string>
#include <vector>

#include "eval/report/text_table.h"
#include "eval/statistics/comparison.h"
#include "eval/store/run_store.h"

namespace robostress {

// A cell that two run directories both have: equal policy name, severity, scenario and method,
// the tasks that both have, of all suites together. An empty scenario is the average over those
// below it that are compared in the same way, Clean excluded.
struct StoreRow {
  std::string policy, scenario, title, method;
  int severity = 5;
  int n_first = 0, n_second = 0;
  double first = 0, second = 0;  // success rates; of an average, means over scenarios
  BootstrapResult difference;    // second - first
  // Present where episodes pair (suite, seed, task, episode, initial state); then the difference is
  // of the pairs alone. Otherwise the two are resampled apart.
  std::optional<Comparison> paired;
};

struct StoreComparison {
  std::string first, second;  // directories
  std::vector<StoreRow> rows;
  // Scenario files that hold something else in the second, whose cells are left out; what is in one
  // store alone, other models under the same name, other configurations, episodes without a
  // partner.
  std::vector<std::string> notes;
};

// Holm's correction is over all paired scenarios, and over all averages. FailedPrecondition when
// the stores have no cell in common.
absl::StatusOr<StoreComparison> CompareStores(const RunData& first, const RunData& second,
                                              int bootstrap_replicates);

// Rows as cells, heading first.
TextRows StoreCells(const StoreComparison& comparison);
std::string StoreJson(const StoreComparison& comparison);
// A page that needs nothing else, with a plot of the differences.
std::string StorePage(const StoreComparison& comparison);

// Compares two run directories, prints the table and writes compare.md, .csv, .json and .html into
// `out` (empty: runs/compare).
absl::Status CompareRunDirectories(const std::string& first, const std::string& second,
                                   const std::string& out, int bootstrap_replicates);

}  // namespace robostress
