#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/recordings/joint_messages.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// A topic as a recording declares it.
struct RosTopic {
  std::string name, type;
  std::string encoding;  // of its messages: "cdr"
  std::string schema_encoding;
  std::optional<std::string> schema;  // none: the recording holds no definition
};

// Messages of ROS 2 topics, from whatever file, as rows of joints. A message that can not be read
// is counted, not believed; the first of a topic is said.
class RosRecording {
 public:
  static constexpr uint64_t kMostMessage = uint64_t{16} << 20;  // of one that is decoded [bytes]

  // `file`: for notes.
  RosRecording(std::string file, RowStream* rows) : file_(std::move(file)), rows_(rows) {}

  // The topic's number for Take. A topic that can not be decoded is a channel without joints; why
  // is a note.
  absl::StatusOr<size_t> AddTopic(const RosTopic& topic);
  absl::Status Take(size_t topic, int64_t log_ns, absl::string_view message);
  // Says what could not be read.
  void Finish();

 private:
  struct Topic {
    RosTopic declared;
    size_t channel = 0;
    JointMessageKind kind = JointMessageKind::kNone;
    std::vector<RosSchema> schemas;  // that may be its; one after the first message is read
    int64_t messages = 0, unread = 0;
    std::string why_unread;
  };
  absl::StatusOr<JointMessage> Decode(Topic* topic, absl::string_view message) const;

  const std::string file_;
  RowStream* const rows_;
  std::vector<Topic> topics_;
  std::vector<SignalValue> values_;
};

}  // namespace robostress
