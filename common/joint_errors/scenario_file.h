#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/joint_errors/scenarios.h"
#include "common/robot_description.h"

namespace robostress {

// A scenario of one's own: effects of the library at the joints of the arm, with physical values,
// beside the paper's errors of a built-in scenario.
//   title: Worn elbow          # optional; else the file's name
//   base: clean                # optional: a built-in scenario, at the unit's severity level
//   joints:
//     - name: J4               # one of the arm's
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

// A file is for one arm: `robot`. Errors name file, key, value and what is allowed.
absl::StatusOr<ScenarioFile> ReadScenarioFile(const std::string& file,
                                              const RobotDescription& robot);
absl::StatusOr<ScenarioFile> ParseScenarioFile(const std::string& file, const std::string& yaml,
                                               const RobotDescription& robot);
std::string WriteScenarioFile(const ScenarioFile& scenario, const RobotDescription& robot);
// Index of the joint of that name, or -1; "J1 to J7" of a robot's joints.
int FindJoint(const RobotDescription& robot, absl::string_view name);
std::string KnownJoints(const RobotDescription& robot);

// True for names of scenarios that are paths of scenario files: they end in .yaml.
bool IsScenarioFile(const std::string& scenario);
// What ids, rows and tables call a scenario: its name, or the file's without folder and ending.
std::string ScenarioLabel(const std::string& scenario);

struct EffectRange {
  double lower = 0, upper = 0;  // may be reached
};
// What a scenario may give parameter `index` of an effect at `joint`: the library's bounds at the
// arm's scales (motor limit, half a turn, largest velocity, control period, reach).
struct EffectInfo;
EffectRange RangeInScenario(const EffectInfo& effect, size_t index, const RobotDescription& robot,
                            int joint);

}  // namespace robostress
