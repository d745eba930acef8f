#include "tests/calibration/generator/machine_family.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress::generator {
namespace {

bool HasName(const std::vector<std::string>& names, const std::string& name) {
  return std::find(names.begin(), names.end(), name) != names.end();
}

}  // namespace

const char* FamilyName(Family family) {
  constexpr const char* kNames[] = {"any",          "servo", "torque", "inverse",
                                    "transmission", "slide", "arm"};
  return kNames[static_cast<int>(family)];
}

absl::StatusOr<Family> ParseFamily(const std::string& name) {
  if (name == "any") return Family::kAny;
  std::vector<std::string> known = {"any"};
  for (const Family family : kFamilies) {
    if (name == FamilyName(family)) return family;
    known.push_back(FamilyName(family));
  }
  return absl::NotFoundError(
      absl::StrCat("family '", name, "' is unknown; known: ", absl::StrJoin(known, ", ")));
}

std::vector<Family> FamiliesOf(const std::string& effect) {
  using enum Family;
  if (HasName({"cross_joint_coupling", "cross_joint_friction", "cross_joint_rubbing",
               "cross_joint_inertia", "base_tilt"},
              effect))
    return {kArm};
  if (effect == "gravity_dependent_friction") return {kServo, kTorque, kInverse, kArm};
  if (effect == "encoder_eccentricity") return {kServo, kTransmission};
  if (effect == "rate_limit") return {kServo, kSlide};
  if (HasName({"transport_delay", "servo_lag", "delay_jitter"}, effect))
    return {kServo, kSlide, kTransmission};
  if (HasName({"backlash", "compliance", "transmission_error", "intermittent_slip"}, effect))
    return {kServo, kSlide, kTransmission};
  if (effect == "encoder_gain") return {kServo, kTransmission};
  if (effect == "encoder_offset") return {kServo, kTorque};
  if (effect == "gravity_error") return {kServo, kTorque, kInverse, kSlide, kArm};
  if (effect == "second_mass" || effect == "quantised_command") return {kServo, kSlide};
  if (HasName({"torque_saturation", "deadzone", "time_varying_gain", "motor_gain",
               "load_dependent_friction", "current_ripple"},
              effect))
    return {kServo, kTorque, kInverse, kSlide};
  return {kServo, kTorque, kInverse, kSlide, kArm};
}

}  // namespace robostress::generator
