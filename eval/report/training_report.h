#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// What `robostress train` logged in one --out: the columns of train.jsonl over the step they belong
// to. Several lines may speak of one step (losses, held-out errors, success).
struct TrainingRun {
  struct Column {
    std::vector<double> step, value;
  };
  std::string dir, name;  // name: the folder's, unless two are equal
  std::string config;     // config.yaml, resolved
  double batch = 0;       // frames per step, from it
  std::map<std::string, Column> columns;

  const Column* Find(const std::string& column) const;
  // The last value of a column, NaN where there is none.
  double Last(const std::string& column) const;
};

// Reads DIR/train.jsonl and config.yaml. The error names file and line. A step that was logged
// twice, by a run that was cut off after its log and resumed, counts once, as logged last.
absl::StatusOr<TrainingRun> LoadTrainingRun(const std::string& dir);

// Curves of losses, held-out errors and success over the steps, all runs in one plot each, and a
// table of what each run cost and where it ended. HTML for the report's page.
std::string TrainingSection(const std::vector<TrainingRun>& runs);
// The section alone as a page that needs nothing else.
std::string TrainingPage(const std::vector<TrainingRun>& runs);

}  // namespace robostress
