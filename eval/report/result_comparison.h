#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/report/result_file.h"
#include "eval/report/text_table.h"
#include "eval/statistics/unpaired_rates.h"

namespace robostress {

// A laboratory's results under the name that a table gives them.
struct NamedResults {
  std::string name;
  ResultFile file;
};

// One policy of one file; the first column is what the others are compared with.
struct ResultColumn {
  std::string name;    // "lab_a: pi05", or the file's name where it holds one policy
  size_t file = 0;     // index
  std::string policy;  // label
  bool noise_paired = true;
};

// One suite, scenario, severity and method; an empty scenario: the mean over `scenarios`.
struct ResultRow {
  std::string suite, scenario, method;
  std::vector<std::string> scenarios;
  int severity = 0;
  std::vector<std::optional<ResultCell>> cells;            // [columns]
  std::vector<std::optional<RateDifference>> differences;  // [columns]; to the first
  std::vector<double> p_holm;                              // [columns]; NaN: none
};

struct ResultComparison {
  std::vector<ResultColumn> columns;
  std::vector<ResultRow> rows;
  std::vector<std::string> refused;  // what is not comparable, by name, and why
  std::vector<std::string> notes;
};

// Results of several laboratories beside each other. They share no episode, so that nothing pairs:
// intervals and p values are CompareRates'; of means over scenarios DifferenceInterval of the two
// bootstrap intervals, without a p value. Holm's correction is over all p values of the table.
// Cells are comparable where suite, severity, scenario's hash, method's options and protocol are
// equal; episodes and first initial state may differ. INVALID_ARGUMENT below two columns;
// FAILED_PRECONDITION, with all reasons, where no cell is comparable.
absl::StatusOr<ResultComparison> CompareResults(const std::vector<NamedResults>& labs);

// Rows as cells, heading first; a line for each column after the first.
TextRows ResultCells(const ResultComparison& comparison);
std::string ResultComparisonJson(const ResultComparison& comparison);
// A page that needs nothing else.
std::string ResultComparisonPage(const ResultComparison& comparison);
// What stands below such a table.
std::string ResultComparisonMethod();

}  // namespace robostress
