#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/plan/plan.h"
#include "eval/store/run_store.h"

namespace robostress {

// What a run's episodes ended in and nothing else of them: one JSON line per finished unit in
// canonical order, one character per episode ('1' success), about half a kilobyte for 200 episodes.
// Small enough to be kept beside the text that quotes it, and enough for every count, interval and
// paired difference of success.
//
//   {"unit": "tabletop_goal-clean-L5-nano-base-s0", "suite", "scenario", "severity", "policy",
//    "method", "seed", "first_initial_state", "tasks": [0, 1],
//    "outcomes": ["1101", "0111"],          by task; episode i began at first_initial_state + i
//    "updates": 0, "options": "1f0c...",    hash of the sections sim and method
//    "model": "9a3b...", "version": "...", "machines": ["..."],
//    "noise_paired": false}                 where another server drew the sampling noise
absl::StatusOr<std::string> OutcomesText(const RunData& run);

struct Outcomes {
  RunData run;                     // units without measures, records, timing and videos
  std::vector<std::string> notes;  // what a table made of several files must say
};

// Several such files as one run; a unit that stands in two of them counts once. DataLoss lists
// everything that is wrong: lines that cannot be read, units with two outcomes, policies with two
// weights.
absl::StatusOr<Outcomes> ReadOutcomes(const std::vector<std::string>& files);

// Notes on units that ran under other options or cover other episodes than planned. The latter are
// removed from `run`.
std::vector<std::string> HoldAgainstPlan(const std::vector<PlannedUnit>& planned, RunData& run);

}  // namespace robostress
