#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/search/effect_trace.h"
#include "calibration/search/joint_case.h"

namespace robostress::calibration {

// What a joint's declared model lacks.
struct Finding {
  Trace trace;  // its fits are what is best for the rig's metric
  // Of a metric of its own, every fold predicted by what is best for the others; else 0.
  double left_out_declared = 0, left_out_after = 0;
  int max_effects = 0;  // TraceOptions: 0: nothing was to be searched
};

// Traces a joint and settles what the trace leaves open. `leads`: effects that were found on other
// joints; where the data of this joint allow for one of them as well as for what it found, it is
// taken: the same cause on several joints is likelier. Errors: the declared model does not hold.
absl::StatusOr<Finding> SearchJoint(JointCase& joint, const std::vector<std::string>& leads,
                                    const TraceOptions& options);

}  // namespace robostress::calibration
