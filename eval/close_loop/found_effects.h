#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/joint_errors/scenario_file.h"
#include "common/robot_description.h"
#include "nlohmann/json_fwd.hpp"

namespace robostress {

// An effect that calibration added to a joint of an arm.
struct FoundEffect {
  int joint = 0;  // 0: J1
  std::string type, verdict;
  std::vector<double> values;
  std::vector<std::string> ambiguous_with;
};

struct FoundEffects {
  std::string verdict;  // of the rig
  std::vector<FoundEffect> effects;
  std::vector<std::string> notes;
};

// Runs `robostress calibrate` for `command` on a rig unless `out` holds its report; progress goes
// to `log`.
absl::Status RunCalibration(const std::string& command, const std::string& rig_file,
                            const std::string& out, const std::string& log, int surrogates,
                            uint64_t seed, int max_effects = 3);

// What the calibration in `folder` added to the rig, mapped to the arm's own joints, and as a
// scenario in `scenario_file`, which is written only where something was added.
absl::StatusOr<FoundEffects> ReadFoundEffects(const std::string& rig_file,
                                              const std::string& folder,
                                              const std::string& scenario_file,
                                              const RobotDescription& arm);

// What --hidden names: a scenario file, or kNothingHidden, the control.
inline constexpr char kNothingHidden[] = "clean";
absl::StatusOr<ScenarioFile> ReadHidden(const std::string& hidden, const RobotDescription& arm);
// For a circle's options: the whole path, or kNothingHidden.
std::string HiddenPlace(const std::string& hidden);

// A directory belongs to one circle, so that steps of two are not mixed: writes `options` to
// `file`, or refuses where it holds others.
absl::Status KeepCircleOptions(const std::string& file, const nlohmann::ordered_json& options);

std::string JointName(int joint);  // 0: "J1"
// {"joint", "type", "parameters": {...}}
nlohmann::ordered_json EffectJson(int joint, const std::string& type,
                                  const std::vector<double>& values);
nlohmann::ordered_json EffectJson(const FoundEffect& effect);
// "B 0.01 rad", for people.
std::string EffectValues(const std::string& type, const std::vector<double>& values);
std::string EffectLine(const FoundEffect& effect);

}  // namespace robostress
