#pragma once

#include <cmath>
#include <limits>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/statistics.h"
#include "eval/report/text_table.h"

namespace robostress {

// A table of the paper with our numbers beside the published ones.
struct FilledCell {
  std::optional<double> value;  // in the table's unit
  Interval interval{std::numeric_limits<double>::quiet_NaN(),
                    std::numeric_limits<double>::quiet_NaN()};
  int n = 0;         // episodes; 0 for published numbers
  std::string note;  // "12 updates", "not adapted"
  bool best = false;
};

struct FilledGroup {
  std::string title;  // a policy of ours, or a backbone of the paper
  bool published = false;
  std::vector<std::string> columns;
};

struct FilledRow {
  std::string title;
  bool average = false;
  std::vector<FilledCell> cells;  // the groups' columns, one group after the other
};

struct FilledTable {
  std::string name, label, caption, row_heading = "Scenario";
  int decimals = 1;  // of values and of interval ends; success rates have whole ends
  std::vector<FilledGroup> groups;
  std::vector<FilledRow> rows;
  TextRows differences;  // heading first; empty when nothing is compared
  std::string figure;    // SVG, or empty
  // How n and intervals are to be read.
  std::string reading =
      "Ours with 95 % intervals: Wilson's for a success rate, the cluster bootstrap over (task, "
      "initial state) for an average and a residual. n: episodes of each of our cells. Bold: best "
      "of its group, as in the paper; it is no test.";
  std::vector<std::string> notes;  // differences in protocol, and what is missing
};

// Marks the largest value of each group in each row, as the paper's bold print does; ties all.
void MarkBest(FilledTable& table);

// For a terminal, a README, a spreadsheet (one row per cell), a program, and a browser (one page
// that needs nothing else; `videos`: HTML put before the notes).
std::string FilledText(const FilledTable& table);
std::string FilledMarkdown(const FilledTable& table);
std::string FilledCsv(const FilledTable& table);
std::string FilledJson(const FilledTable& table);
std::string FilledPage(const FilledTable& table, const std::string& videos);
// Publishes folder/NAME.csv, .md, .json and .html.
absl::Status WriteFilledTable(const FilledTable& table, const std::string& folder,
                              const std::string& videos = "");

}  // namespace robostress
