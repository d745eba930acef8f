#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"
#include "calibration/fidelity/replay_comparison.h"
#include "common/joint_errors/scenario_file.h"
#include "eval/close_loop/found_effects.h"
#include "eval/close_loop/recorded_run.h"

namespace robostress {

// The whole circle: errors hidden in the simulated arm, found again from its logs, and compared.
struct CloseLoopOptions : RecordingOptions {
  std::string hidden;  // scenario file; no rig declares what it holds
  std::string out;
  std::string policy = "expert";  // evaluated; recordings are always the expert's
  int evaluated_episodes = 20;    // of each task, from the reporting split (0 ...)
};

struct SuccessRate {
  int successes = 0, episodes = 0;
};

// Episodes, of those of the hidden scenario, that a scenario ends in the same way: the same task
// and initial state succeeds in both or fails in both.
struct Agreement {
  int same = 0, episodes = 0;
};

struct CloseLoopResult {
  calibration::RecordedRigSummary rig;
  std::vector<ScenarioEffect> hidden;
  FoundEffects found;
  // Of episodes that were not fitted (held out and transfer).
  calibration::ReplayComparison replay_before, replay_after;
  int replayed_episodes = 0;
  SuccessRate clean, under_hidden, under_found;  // found: of Clean where nothing was found
  Agreement clean_agrees, found_agrees;
};

// Leaves in out: recording/ (a sweep with joint logs), rig/, calibration/ (what `robostress
// calibrate` wrote), found.yaml (where effects were added), evaluation/ (a sweep over Clean, the
// hidden and the found scenario) and summary.json, last. Steps that are complete are not repeated.
absl::StatusOr<CloseLoopResult> CloseLoop(const CloseLoopOptions& options);
// The result for people.
std::string CloseLoopTable(const CloseLoopResult& result);

}  // namespace robostress
