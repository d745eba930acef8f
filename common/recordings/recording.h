#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// What a path holds, for a title: "MCAP file", "rosbag2 folder".
absl::StatusOr<std::string> KindOfRecording(const std::string& path);

struct ReadRecordingOptions {
  double rate_hz = 0;  // of rows that have no times of their own; 0: what the file says
};

// Streams a recording to `visitor`, front to back, in as much memory as its largest chunk, message
// or episode takes:
//
//   FILE.mcap, FILE.db3         https://mcap.dev, rosbag2's sqlite3 storage; also .zstd
//   FOLDER with metadata.yaml   of rosbag2, split into files of either kind
//   FILE.hdf5, FOLDER of them   of ALOHA, robomimic or LIBERO
//   FOLDER with meta/info.json  a data set of LeRobot v2.x or v3.0
//   FILE.csv                    columns of a rig's log; the table is held in memory
//
// INVALID_ARGUMENT names file, field, value and remedy.
absl::Status ReadRecording(const std::string& path, const ReadRecordingOptions& options,
                           RecordingVisitor* visitor);

}  // namespace robostress
