#include "robot_client/cameras/frame_source.h"

#include "absl/strings/str_format.h"

namespace robostress {

absl::Status FutureStampError(const std::string& camera, int64_t stamp_ns, int64_t now_ns) {
  return absl::DataLossError(absl::StrFormat(
      "camera '%s': its newest picture is stamped %.3f s in the future, so its age is unknown; "
      "stamps must be CLOCK_MONOTONIC of this machine: correct the clock of what writes them",
      camera, (static_cast<double>(stamp_ns) - static_cast<double>(now_ns)) * 1e-9));
}

}  // namespace robostress
