#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/paper/filled_table.h"

// The real-arm tables, on emulated arms: what `robostress piper-study` left.
namespace robostress {

// A row of its episodes.csv.
struct PiperEpisode {
  std::string arm;     // wear profile: new (the paper's Robot A), used_one_year (Robot B)
  std::string policy;  // as it was named
  std::string method;  // base, robust, ours, dob, dob_ours
  int task = 1;        // the paper's number, 1 to 4
  int variant = 0;     // 0: the objects of the demonstrations; 1 to 5: unseen
  int episode = 0;
  bool success = false;
  int updates = 0;  // applied when it ended
};

// The columns are found by their names: arm, policy, method, task, variant, episode, success (0 or
// 1), updates; others are left alone. NotFound without a row; DataLoss names file, line, column and
// value.
absl::StatusOr<std::vector<PiperEpisode>> ReadPiperEpisodes(const std::string& csv_file);

// "real-arm", "dob" or "unseen" of the episodes, with Wilson's intervals; averages over tasks with
// the cluster bootstrap; methods are paired with base on (task, variant, episode).
FilledTable PiperTable(const std::string& table, const std::vector<PiperEpisode>& episodes,
                       int bootstrap_replicates);

}  // namespace robostress
