#pragma once

#include <string>

#include "absl/status/status.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// A CSV file with columns t [s], q_JOINT, dq_JOINT, tau_JOINT, q_cmd_JOINT in radians and SI units,
// as logs of a rig; other columns are passed over. INVALID_ARGUMENT names file, line and column.
absl::Status ReadCsvRecording(const std::string& path, RowStream* rows);

}  // namespace robostress
