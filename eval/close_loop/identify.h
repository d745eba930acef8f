#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/recorded_rig.h"
#include "eval/close_loop/found_effects.h"

namespace robostress {

// Joint errors of simulated arms from their own first episodes, for `ours_identified`.
struct IdentifyOptions {
  std::vector<std::string> scenarios;  // one arm each, as `sweep` takes them
  std::string out;
  std::string policy = "nano";
  std::string suite = "tabletop_goal";
  std::vector<int> tasks = {0, 1, 3};  // the last is the transfer regime
  int episodes = 6;                    // of each task, from the dev split (40 ...)
  int severity = 5;
  int workers = 2;
  double rate_hz = 250;
  int surrogates = 199;
  uint64_t seed = 0;  // of encoder noise and surrogates
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
