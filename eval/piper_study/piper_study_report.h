#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/statistics.h"
#include "eval/piper_study/piper_study.h"

namespace robostress {

// An episode of a finished unit.
struct PiperStudyEpisode {
  PiperUnit unit;
  int variant = 0;  // of kPiperVariants
  std::string instruction;
  int episode = 0;
  bool success = false;
  double residual = 0;  // ||q(t+1) - target|| / ||target - q(chunk)||
  double eta_sq = 0, displacement_sq = 0;
  int64_t updates = 0;  // applied when it ended
  int64_t steps = 0, steps_masked = 0;
  int power_cycles = 0;
  double seconds = 0;
};

// A method on one arm and task; `versus_base` over the same initial states.
struct PiperCell {
  int n = 0, successes = 0;
  Interval wilson;
  double residual = 0;  // mean of the episodes
  int64_t updates = 0;  // at the end
  bool paired = false;
  BootstrapResult versus_base;
  int plus = 0, minus = 0;  // pairs that only it, or only base won
};

// Episodes of the units that have DONE, in the plan's order; DATA_LOSS names file and line.
absl::StatusOr<std::vector<PiperStudyEpisode>> ReadPiperStudy(const std::vector<PiperUnit>& units,
                                                              const std::string& folder);
// Cell of `method` among the episodes for which `of` holds, paired with base of the same arm, task,
// variant and episode.
PiperCell MakePiperCell(const std::vector<PiperStudyEpisode>& episodes, const std::string& method,
                        const std::string& label);
// Words of a nano policy's vocabulary that an instruction has and the policy does not.
absl::StatusOr<std::vector<std::string>> UnknownWords(const std::string& weights,
                                                      const std::string& instruction);

// Writes episodes.csv (arm, policy, method, task, variant, episode, success, residual, updates
// ...), report.json and report.md from out/<kind>/ (units or live), and prints the tables.
absl::Status WritePiperReport(const PiperStudyOptions& options, const std::vector<PiperUnit>& units,
                              const std::string& out, const std::string& kind,
                              const std::string& weights);

}  // namespace robostress
