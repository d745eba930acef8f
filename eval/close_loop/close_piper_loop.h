#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"
#include "common/joint_errors/scenario_file.h"
#include "eval/close_loop/found_effects.h"

namespace robostress {

// The whole circle on an emulated Piper: errors hidden in it are found in a client's recording, and
// arms without and with what was found repeat the recorded motions.
struct ClosePiperLoopOptions {
  std::string hidden;  // scenario file, joints J1 to J6
  std::string out;
  int episodes = 6;  // of eight reaches; each third one is held out
  int surrogates = 999;
  uint64_t seed = 0;  // of surrogates
};

struct ClosePiperLoopResult {
  calibration::RecordedRigSummary rig;
  std::vector<ScenarioEffect> hidden;
  FoundEffects found;
  int unseen_episodes = 0;
  // rms over the unseen episodes and the joints, from the recording's [rad].
  double before_rad = 0, after_rad = 0;
};

// Leaves in out: recording/, rig/, calibration/, found.yaml (where effects were added), without/
// and with/ (the repeated motions) and summary.json, last. Steps that are complete are not
// repeated.
absl::StatusOr<ClosePiperLoopResult> ClosePiperLoop(const ClosePiperLoopOptions& options);
std::string ClosePiperLoopTable(const ClosePiperLoopResult& result);  // for people

}  // namespace robostress
