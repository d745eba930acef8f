#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/recordings/cdr_decoder.h"
#include "common/recordings/row_stream.h"

namespace robostress {

// Messages of ROS 2 that joints are read from, by the fields that the recording's schema has.
enum class JointMessageKind {
  kNone,
  kJointState,       // sensor_msgs/JointState: position, velocity, effort
  kControllerState,  // control_msgs/JointTrajectoryControllerState: feedback (or actual), and as
                     // command reference (or desired)
  kTrajectory,       // trajectory_msgs/JointTrajectory: its last point is a goal
  kArray,            // std_msgs/Float64MultiArray: commands of joints that it does not name
};
// "sensor_msgs/msg/JointState", with or without "msg/".
JointMessageKind KindOfType(absl::string_view type);
// Whether the last part of a topic's name says that it asks: a JointState below
// "/arm/joint_command" (command, commands, cmd, desired, target) is one of commands.
bool IsCommandTopic(absl::string_view topic);
// What such a channel is, its unit, its caution.
RecordedChannel DescribeTopic(const std::string& topic, const std::string& type);

struct JointReading {
  std::string joint;
  JointQuantity quantity = JointQuantity::kPosition;
  double value = 0;
};

struct JointMessage {
  int64_t stamp_ns = 0;  // header.stamp
  bool stamped = false;  // false: the message has none, or it is 0
  std::vector<JointReading> readings;
};

// INVALID_ARGUMENT names the field: it is not there, its length is not that of the names, a name
// stands twice.
absl::StatusOr<JointMessage> ReadJointMessage(JointMessageKind kind, const RosSchema& schema,
                                              const CdrValue& message);

// Definitions for recordings without any, the present one first; no element of other types.
std::vector<std::string> KnownDefinitions(JointMessageKind kind);

}  // namespace robostress
