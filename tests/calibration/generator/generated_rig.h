#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "tests/calibration/generator/hidden_machine.h"
#include "tests/calibration/generator/machine_family.h"

namespace robostress::generator {

// kBrief: two short logs to fit, full of everything, for tests that must be quick.
enum class Richness { kAny, kRich, kPoor, kBrief };
// What beside its hidden effects makes a rig hard to tell.
enum class Hardship {
  kNone,
  kSlow,          // 50 rows per second
  kDrops,         // one row in a hundred is missing, up to three in a row
  kJitter,        // rows are read 0.3 ms before or after the time that the log gives them
  kRamped,        // the command steps every fourth row, and the log holds a line between the steps
  kResampled,     // the same, and the whole log was resampled linearly to 0.8 of its rate
  kLongWave,      // wavelengths of 2.6 to 5 times half the way travelled
  kCoulomb,       // hidden friction has no Stribeck rise
  kFrictionless,  // no dry friction but what is hidden
  kHarsh,     // a rate limit at 0.4 of its size, and four declared parameters more that may move
  kNoTorque,  // nobody logs the torque; a machine that is driven by it or tells it does
};

// One more log to fit, made of another: with times its speed, its size about its middle and the
// servo's gain (kd by its root), and a known mass at the tip [kg].
struct ProposedRun {
  int log = 0;
  double speed = 1, size = 1, gain = 1, mass = 0;
};

// A log to fit of a given motion, q[joint][row] at the rig's rate, with times the servo's gain (kd
// by its root), and a known mass at the tip [kg].
struct PlayedRun {
  std::vector<std::vector<double>> q;
  double gain = 1, mass = 0;
};

struct RigOptions {
  // What the rig does not declare: names of LibraryEffects() or OutsideEffects(); none: nothing.
  std::vector<std::string> effects;
  Size size = Size::kMedium;
  uint64_t seed = 1;
  Family family = Family::kAny;  // kAny: drawn among those in which the effects can be seen
  Richness richness = Richness::kAny;
  Hardship hardship = Hardship::kNone;
  bool apart = false;  // two effects act on different joints of an arm; else on one
  std::optional<ProposedRun> proposed;
  // In the place of all logs to fit those of these motions; empty: those that are drawn.
  std::vector<PlayedRun> played;
};

// A rig as files would hold it, and what is true of it.
struct GeneratedRig {
  struct Log {
    std::string role;       // fit | held_out | transfer
    std::string overrides;  // as in a rig file
    Recording recording;
  };
  Family family = Family::kServo;
  std::string joint_names[2] = {"hinge", "elbow"};
  Machine truth;
  Machine declared;  // what the MJCF and the servo say; effects: those declared
  std::vector<std::vector<std::string>> fit;  // per joint, of the declared model's parameters
  bool declares_dry_friction = false;         // as a stribeck_friction effect
  std::vector<std::vector<std::string>> friction_fit;  // per joint, of its parameters
  double rate_hz = 200;
  bool logs_torque = true;
  bool logs_temperature = false;  // temp_<joint>, kCold and what the joint is warmer, in steps
  bool commands_hold = true;      // over a row; else the servo sees them continuously
  double window_s = 0.5;
  std::vector<Log> logs;
  // rms change of the first log's readings that the hidden effects make, over the noise: below
  // about 1 nobody could see them.
  double visibility = 0;
  std::vector<double> visibility_of;  // the same of each effect of `truth` beside the others
};

// Errors list the known names.
absl::StatusOr<Hardship> ParseHardship(const std::string& name);

// Errors: an unknown effect, effects that no family shows together.
absl::StatusOr<GeneratedRig> GenerateRig(const RigOptions& options);

// model.xml, rig.yaml, log_<i>.csv and truth.json in `folder`, which is made.
absl::Status WriteGeneratedRig(const GeneratedRig& rig, const RigOptions& options,
                               const std::string& folder);

}  // namespace robostress::generator
