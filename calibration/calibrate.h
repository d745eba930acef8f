#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "calibration/search/calibration_report.h"
#include "calibration/search/effect_trace.h"

namespace robostress::calibration {

struct Calibration {
  CalibrationReport report;
  Rig after;  // the rig with what was added and fitted; `file` is the declared one's
};

// Reads the logs of a rig, traces every joint, and judges. Errors: what rig, logs and model refuse.
absl::StatusOr<Calibration> Calibrate(const Rig& rig, const TraceOptions& options);

}  // namespace robostress::calibration
