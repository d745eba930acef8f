#include "common/recordings/ros_recording.h"

#include <utility>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<size_t> RosRecording::AddTopic(const RosTopic& declared) {
  Topic topic;
  topic.declared = declared;
  RecordedChannel description = DescribeTopic(declared.name, declared.type);
  std::string why_not;
  if (description.decoded) {
    topic.kind = KindOfType(declared.type);
    if (declared.encoding != "cdr") {
      why_not = absl::StrCat("its messages are encoded as '", declared.encoding, "'; read is cdr");
    } else if (declared.schema && declared.schema_encoding != "ros2msg") {
      why_not = absl::StrCat("its schema is written as '", declared.schema_encoding,
                             "'; read is ros2msg");
    } else {
      const std::vector<std::string> texts =
          declared.schema ? std::vector{*declared.schema} : KnownDefinitions(topic.kind);
      for (const std::string& text : texts) {
        absl::StatusOr<RosSchema> schema = RosSchema::Parse(declared.type, text);
        if (schema.ok())
          topic.schemas.push_back(*std::move(schema));
        else
          why_not = std::string(schema.status().message());
      }
      if (!declared.schema)
        rows_->visitor().OnNote(absl::StrCat(file_, ": ", declared.name, ": the file has no ",
                                             "definition of ", declared.type,
                                             "; it is read by this program's own"));
    }
  }
  if (topic.schemas.empty()) topic.kind = JointMessageKind::kNone;
  description.decoded = topic.kind != JointMessageKind::kNone;
  if (!why_not.empty())
    rows_->visitor().OnNote(absl::StrCat(file_, ": ", declared.name, " is not read: ", why_not));
  RS_ASSIGN_OR_RETURN(topic.channel, rows_->Channel(description));
  topics_.push_back(std::move(topic));
  return topics_.size() - 1;
}

absl::StatusOr<JointMessage> RosRecording::Decode(Topic* topic, absl::string_view message) const {
  if (message.size() > kMostMessage)
    return absl::InvalidArgumentError(
        absl::StrCat("is ", message.size(), " bytes long, at most ", kMostMessage));
  absl::Status first;
  for (size_t i = 0; i < topic->schemas.size(); ++i) {
    const absl::StatusOr<CdrValue> value = DecodeCdr(topic->schemas[i], message);
    absl::StatusOr<JointMessage> read =
        value.ok() ? ReadJointMessage(topic->kind, topic->schemas[i], *value) : value.status();
    if (read.ok()) {
      if (topic->schemas.size() > 1) topic->schemas = {topic->schemas[i]};
      return read;
    }
    if (first.ok()) first = read.status();
  }
  return first;
}

absl::Status RosRecording::Take(size_t index, int64_t log_ns, absl::string_view message) {
  Topic& topic = topics_[index];
  ++topic.messages;
  JointRow row;
  row.channel = topic.channel;
  row.log_ns = row.stamp_ns = log_ns;
  values_.clear();
  if (topic.kind != JointMessageKind::kNone) {
    const absl::StatusOr<JointMessage> read = Decode(&topic, message);
    if (!read.ok()) {
      if (topic.unread++ == 0)
        topic.why_unread = absl::StrCat("message ", topic.messages, ": ", read.status().message());
      return absl::OkStatus();
    }
    if (read->stamped) row.stamp_ns = read->stamp_ns;
    row.stamped = read->stamped;
    const bool asks =
        topic.kind == JointMessageKind::kJointState && IsCommandTopic(topic.declared.name);
    for (const JointReading& reading : read->readings) {
      // Velocities and torques that are asked for are no measurements, and no commands of
      // positions.
      if (asks && reading.quantity != JointQuantity::kPosition) continue;
      RS_ASSIGN_OR_RETURN(const size_t signal,
                          rows_->Signal(topic.channel, reading.joint,
                                        asks ? JointQuantity::kCommand : reading.quantity));
      values_.push_back({signal, reading.value});
    }
  }
  row.values = values_;
  return rows_->visitor().OnRow(row);
}

void RosRecording::Finish() {
  for (const Topic& topic : topics_) {
    if (topic.unread > 0)
      rows_->visitor().OnNote(absl::StrCat(file_, ": ", topic.declared.name, ": ", topic.unread,
                                           " of ", topic.messages, " messages are left out; ",
                                           topic.why_unread));
  }
}

}  // namespace robostress
