#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::generator {

enum class Family { kAny, kServo, kTorque, kInverse, kTransmission, kSlide, kArm };
// All but kAny.
inline constexpr Family kFamilies[] = {Family::kServo,        Family::kTorque, Family::kInverse,
                                       Family::kTransmission, Family::kSlide,  Family::kArm};

const char* FamilyName(Family family);
// Errors list the known names.
absl::StatusOr<Family> ParseFamily(const std::string& name);
// Families in which `effect` has an influence on what is compared.
std::vector<Family> FamiliesOf(const std::string& effect);

}  // namespace robostress::generator
