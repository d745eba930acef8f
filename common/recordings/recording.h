#pragma once

#include <string>

#include "absl/status/status.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// What a path holds, for a title: "MCAP file", "rosbag2 folder".
absl::StatusOr<std::string> KindOfRecording(const std::string& path);

// Streams a recording to `visitor`, front to back, in as much memory as its largest chunk, message
// or episode takes:
//
//   FILE.mcap, FILE.db3         https://mcap.dev, rosbag2's sqlite3 storage; also .zstd
//   FOLDER with metadata.yaml   of rosbag2, split into files of either kind
//
// INVALID_ARGUMENT names file, field, value and remedy.
absl::Status ReadRecording(const std::string& path, RecordingVisitor* visitor);

}  // namespace robostress
