#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/report/result_file.h"

namespace robostress {

// What a leaderboard asks of a result and a run does not know. Each is "key=value" on the command
// line, with the field's name of vla-eval's leaderboard.schema.json as its key.
struct LeaderboardEntry {
  std::string model;         // key in the manner of BibTeX, "kim24openvla"
  std::string weight_type;   // shared, finetuned
  std::string curated_by;    // "@handle"
  std::string display_name;  // absent: the policy's label
  std::optional<std::string> params, model_paper, reported_paper;
};
// INVALID_ARGUMENT names the key, what it must be and the known ones.
absl::StatusOr<LeaderboardEntry> ParseLeaderboardEntry(const std::vector<std::string>& assignments);

// leaderboard.json of vla-eval with an entry for each method and severity level of the one policy
// of `file`, benchmark "robostress"; success in percent by scenario. `date`: YYYY-MM-DD.
// overall_score, the mean over the seven scenarios with errors, is given where the protocol is
// whole (docs/results/ sharing-results.md), else null with the mean of what was run as
// task_scores.reported_avg: the leaderboard ranks by it. It has no field for n, intervals, controls
// and noise; `notes` says them. FAILED_PRECONDITION where the file holds several policies.
absl::StatusOr<std::string> LeaderboardJson(const ResultFile& file, const LeaderboardEntry& entry,
                                            const std::string& date);

}  // namespace robostress
