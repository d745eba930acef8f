#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "tests/calibration/generator/hidden_machine.h"

namespace robostress::generator {

enum class Family { kAny, kServo, kTorque, kInverse, kTransmission, kSlide, kArm };
// kBrief: two short logs to fit, full of everything, for tests that must be quick.
enum class Richness { kAny, kRich, kPoor, kBrief };

struct RigOptions {
  // What the rig does not declare: names of LibraryEffects() or OutsideEffects(); none: nothing.
  std::vector<std::string> effects;
  Size size = Size::kMedium;
  uint64_t seed = 1;
  Family family = Family::kAny;  // kAny: drawn among those in which the effects can be seen
  Richness richness = Richness::kAny;
};

// A rig as files would hold it, and what is true of it.
struct GeneratedRig {
  struct Log {
    std::string role;  // fit | held_out | transfer
    Recording recording;
  };
  Family family = Family::kServo;
  std::string joint_names[2] = {"hinge", "elbow"};
  Machine truth;
  Machine declared;  // what the MJCF and the servo say; effects: those declared
  std::vector<std::vector<std::string>> fit;  // per joint, of the declared model's parameters
  bool declares_dry_friction = false;         // as a stribeck_friction effect
  std::vector<std::string> friction_fit;      // of its parameters
  double rate_hz = 200;
  bool logs_temperature = false;  // temp_<joint>, kCold and what the joint is warmer, in steps
  bool commands_hold = true;      // over a row; else the servo sees them continuously
  double window_s = 0.5;
  std::vector<Log> logs;
  // rms change of the first log's readings that the hidden effects make, over the noise: below
  // about 1 nobody could see them.
  double visibility = 0;
};

const char* FamilyName(Family family);
absl::StatusOr<Family> ParseFamily(const std::string& name);
// Families in which `effect` has an influence on what is compared.
std::vector<Family> FamiliesOf(const std::string& effect);

// Errors: an unknown effect, effects that no family shows together.
absl::StatusOr<GeneratedRig> GenerateRig(const RigOptions& options);

// model.xml, rig.yaml, log_<i>.csv and truth.json in `folder`, which is made.
absl::Status WriteGeneratedRig(const GeneratedRig& rig, const RigOptions& options,
                               const std::string& folder);

}  // namespace robostress::generator
