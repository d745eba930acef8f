#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace robostress {

struct RosField {
  enum class Kind {
    kBool,
    kInt8,
    kUint8,
    kInt16,
    kUint16,
    kInt32,
    kUint32,
    kInt64,
    kUint64,
    kFloat32,
    kFloat64,
    kString,
    kWideString,
    kStruct
  };
  std::string name;
  Kind kind = Kind::kBool;
  size_t type = 0;  // of a struct: its index in RosSchema::types()
  bool array = false;
  int64_t fixed = -1;    // an array's length where the type says it; -1: it stands in the message
  int64_t most = -1;     // its bound, -1: none
  int64_t longest = -1;  // the bound of a string, -1: none
};

struct RosType {
  std::string name;  // "sensor_msgs/JointState"
  std::vector<RosField> fields;
};

// The types of a ROS 2 message, from the text that MCAP calls ros2msg: the .msg file, then behind
// lines of '=' and "MSG: pkg/Type" those that it needs
// (https://mcap.dev/spec/registry#ros2msg). Constants and defaults are passed over.
class RosSchema {
 public:
  // `name`: "sensor_msgs/msg/JointState". INVALID_ARGUMENT names the type, the line and what is
  // wrong: an unknown type, one that contains itself, an array of no length.
  static absl::StatusOr<RosSchema> Parse(absl::string_view name, absl::string_view text);

  // The first is the message's own.
  const std::vector<RosType>& types() const { return types_; }

 private:
  absl::Status CheckNesting(size_t type, int depth, std::vector<char>* state) const;

  std::vector<RosType> types_;
};

}  // namespace robostress
