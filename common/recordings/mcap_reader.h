#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/recordings/byte_source.h"

namespace robostress {

struct McapSchema {
  std::string name, encoding, text;
  bool operator==(const McapSchema&) const = default;
};

struct McapChannel {
  std::string topic, encoding;  // of its messages: "cdr"
  uint16_t schema = 0;          // 0: none
  bool operator==(const McapChannel&) const = default;
};

struct McapMessage {
  uint16_t channel = 0;
  uint64_t log_time_ns = 0;
  absl::string_view data;  // until the next call
};

// An MCAP file (https://mcap.dev/spec), record by record from its front: neither index nor footer
// is needed, so a file of a recorder that died is read up to its last whole chunk. Memory is that
// of the largest chunk. Trusts nothing: INVALID_ARGUMENT names file, byte, field and value.
class McapReader {
 public:
  // Of a chunk or record, packed or not; rosbag2 writes chunks of 768 KiB, others of 4 MiB.
  static constexpr uint64_t kMostChunk = uint64_t{256} << 20;

  static absl::StatusOr<std::unique_ptr<McapReader>> Open(const std::string& path);

  // False at the end. Messages come as they lie in the file, which need not be by time.
  absl::StatusOr<bool> Next(McapMessage* message);

  // Of a message's channel; the schema may be null.
  const McapChannel& channel(uint16_t id) const { return channels_.at(id); }
  const McapSchema* schema(uint16_t id) const;
  // What was found beside the messages: an end that was cut off.
  const std::vector<std::string>& notes() const { return notes_; }

 private:
  explicit McapReader(std::unique_ptr<ByteSource> source) : source_(std::move(source)) {}
  absl::Status Wrong(const std::string& what) const;
  absl::StatusOr<bool> NextRecord(McapMessage* message);
  absl::StatusOr<bool> Take(uint8_t opcode, absl::string_view content, McapMessage* message);
  absl::Status TakeSchema(absl::string_view content);
  absl::Status TakeChannel(absl::string_view content);
  absl::Status TakeMessage(absl::string_view content, McapMessage* message);
  absl::Status OpenChunk(absl::string_view content);
  void NoteCut(uint64_t lost);

  std::unique_ptr<ByteSource> source_;
  std::map<uint16_t, McapSchema> schemas_;
  std::map<uint16_t, McapChannel> channels_;
  uint64_t table_bytes_ = 0;
  uint64_t record_at_ = 0;  // of the record in hand, for errors
  uint64_t chunks_ = 0;
  std::string record_, chunk_;
  absl::string_view rest_of_chunk_;
  bool ended_ = false;
  std::vector<std::string> notes_;
};

}  // namespace robostress
