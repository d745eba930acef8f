#pragma once

#include "absl/status/status.h"
#include "python/library/robostress.h"

// An arm in arrays laid out as MuJoCo's.
namespace robostress {

// The fields of `given` over those of `arrays`; an error names the first that is missing.
absl::Status ReadArrays(const robostress_arrays* given, robostress_arrays& arrays);

// The torque that holds each joint against gravity, as PandaSim reckons it.
void HoldAgainstGravity(const robostress_arrays& arrays, int joints, double* torque);
// The same [joints][2] as the base tilts about x, y [Nm/rad].
void TiltGravity(const robostress_arrays& arrays, int joints, double* change);
// Of 1 kg at arrays.tool [Nm/kg, kg m^2/kg].
void PayloadAtTool(const robostress_arrays& arrays, int joints, double* gravity, double* inertia);

}  // namespace robostress
