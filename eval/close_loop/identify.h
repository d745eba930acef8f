#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"
#include "eval/close_loop/found_effects.h"
#include "eval/close_loop/recorded_run.h"

namespace robostress {

// Joint errors of simulated arms from their own first episodes, for `ours_identified`.
struct IdentifyOptions : RecordingOptions {
  IdentifyOptions() { surrogates = 199; }
  std::vector<std::string> scenarios;  // one arm each, as `sweep` takes them
  std::string out;
  std::string policy = "nano";
};

struct IdentifiedArm {
  std::string scenario;  // its label
  std::string file;      // what was found, as a scenario; without effects where nothing was
  calibration::RecordedRigSummary rig;
  FoundEffects found;
  double seconds = 0;  // of calibration; 0: it was there
};

// For each scenario out/LABEL_found.yaml, and under out/LABEL/ recording, rig and calibration.
// Steps that are complete are not repeated. What the scenario holds is never read but by the
// simulator.
absl::StatusOr<std::vector<IdentifiedArm>> Identify(const IdentifyOptions& options);
// For people.
std::string IdentifiedTable(const std::vector<IdentifiedArm>& arms);

}  // namespace robostress
