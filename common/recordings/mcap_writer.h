#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/atomic_stream.h"
#include "common/recordings/mcap_reader.h"

namespace robostress {

// An MCAP file (https://mcap.dev/spec) with all that a viewer seeks by: chunks of zstd with CRCs,
// an index of messages behind each, and a summary section of schemas, channels, statistics and the
// indexes of chunks and metadata, with offsets and a CRC of its own. Memory is that of one chunk
// and 100 bytes for each before it. The file appears whole with Publish, or not at all.
class McapWriter {
 public:
  // As rosbag2's; the message that fills a chunk ends it.
  static constexpr uint64_t kChunkBytes = 768 << 10;

  // `profile`: "ros2", or "".
  static absl::StatusOr<McapWriter> Create(const std::string& path, const std::string& profile);

  // Ids count from 1. A channel's schema is one that was added, or 0.
  uint16_t AddSchema(const McapSchema& schema);
  uint16_t AddChannel(const McapChannel& channel);
  // A message of a channel that was added, logged and published at `time_ns`.
  // INVALID_ARGUMENT names a message of more than half of what McapReader takes as a chunk.
  absl::Status Write(uint16_t channel, uint64_t time_ns, absl::string_view data);
  absl::Status AddMetadata(const std::string& name,
                           const std::map<std::string, std::string>& values);
  absl::Status Publish();

 private:
  struct Channel {
    McapChannel declared;
    uint32_t messages = 0;
    std::vector<std::pair<uint64_t, uint64_t>> index;  // in this chunk: time [ns], byte
  };

  explicit McapWriter(AtomicStream file) : file_(std::move(file)) {}
  absl::Status Append(absl::string_view bytes);
  absl::Status EndChunk();
  std::string Statistics() const;
  std::string Summary() const;

  AtomicStream file_;
  uint64_t at_ = 0;   // bytes written
  uint32_t crc_ = 0;  // of them
  std::vector<McapSchema> schemas_;
  std::vector<Channel> channels_;
  std::string chunk_;  // records of the chunk that is being filled
  uint64_t chunk_start_ns_ = 0, chunk_end_ns_ = 0, messages_in_chunk_ = 0;
  uint64_t start_ns_ = 0, end_ns_ = 0;
  uint32_t chunks_ = 0, metadata_ = 0;
  std::string chunk_indexes_, metadata_indexes_;  // records of the summary section
};

}  // namespace robostress
