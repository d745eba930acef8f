#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"
#include "adapter/joint_response.h"
#include "calibration/data/recorded_rig.h"

namespace robostress {

// How the joints of a healthy arm answer targets, from what robot_client recorded of it.
struct ResponseIdentification {
  calibration::RecordedRigSummary rig;
  JointResponseOptions response;
  std::string file;    // a part of the client's configuration
  double seconds = 0;  // of calibration; 0: it was there
};

// Leaves in `out`: rig/, calibration/ and response.yaml. Steps that are complete are not repeated.
absl::StatusOr<ResponseIdentification> IdentifyResponse(const std::string& run,
                                                        const std::string& out, int surrogates,
                                                        uint64_t seed);
std::string ResponseTable(const ResponseIdentification& identified);  // for people

}  // namespace robostress
