#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/joint_errors/scenarios.h"

namespace robostress {

// A scenario of one's own: effects of the library at the joints of the arm, with physical values,
// beside the paper's errors of a built-in scenario.
//   title: Worn elbow          # optional; else the file's name
//   base: clean                # optional: a built-in scenario, at the unit's severity level
//   joints:
//     - name: J4               # J1 .. J7
//       effects:
//         - {type: transport_delay, delay_s: 0.02}
//         - {type: cross_joint_coupling, k: 3, joint: J2}   # reads the position of J2
// Units and signs are the library's (`robostress scenarios --effects`); parameters that the library
// fixes may be left out. Severity levels do not scale effects. Effects of stage sensor are outside
// the paper, which adds no noise to observations: they act on the joint readings that the
// controller sees and that joint logs hold, not on observations, measurements or pictures.
struct ScenarioFile {
  std::string title;
  std::string base = "clean";
  std::vector<ScenarioEffect> effects;
};

// Errors name file, key, value and what is allowed.
absl::StatusOr<ScenarioFile> ReadScenarioFile(const std::string& file);
absl::StatusOr<ScenarioFile> ParseScenarioFile(const std::string& file, const std::string& yaml);
std::string WriteScenarioFile(const ScenarioFile& scenario);

// True for names of scenarios that are paths of scenario files: they end in .yaml.
bool IsScenarioFile(const std::string& scenario);
// What ids, rows and tables call a scenario: its name, or the file's without folder and ending.
std::string ScenarioLabel(const std::string& scenario);

struct EffectRange {
  double lower = 0, upper = 0;
  bool lower_open = false;  // the lower bound itself is refused
};
// What a scenario may give parameter `index` of an effect at `joint`: the library's bounds at the
// arm's scales (motor limit 80 or 12 Nm, half a turn, 2.2 rad/s, control step 0.05 s).
struct EffectInfo;
EffectRange RangeInScenario(const EffectInfo& effect, size_t index, int joint);

}  // namespace robostress
