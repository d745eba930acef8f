#pragma once

#include <Eigen/Dense>

#include "absl/status/statusor.h"

namespace robostress {

struct InertiaRepair {
  Eigen::Matrix3d inertia;        // [kg m^2] about the centre of mass, in the frame given
  Eigen::Vector3d before, after;  // principal moments, rising [kg m^2]
  bool changed = false;           // by more than rounding does
};

// The inertia nearest to `given` (symmetric) whose principal moments A <= B <= C fulfil A + B >= C,
// as those of every body do: with d = C - A - B > 0, A and B grow by d / 3 and C shrinks by d / 3
// (least squares on the moments). Less than 1e-15 kg m^2 is 0. INVALID_ARGUMENT with the value
// where a moment is below 0 by more than rounding, and the body weighs a gram at least: lighter
// ones are frames that an exporter gave some mass, and their moments below 0 become 0 first.
absl::StatusOr<InertiaRepair> RepairInertia(const Eigen::Matrix3d& given, double mass);

}  // namespace robostress
