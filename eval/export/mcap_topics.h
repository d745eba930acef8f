#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/strings/string_view.h"
#include "common/recordings/mcap_writer.h"

namespace robostress {

// "MSG: TYPE" and its text, as it stands behind a definition of ROS that needs it.
std::string RosDefinition(absl::string_view type, absl::string_view text);

// A message of a std_msgs/Header and `fields`; `more`: definitions of what they need.
McapSchema StampedSchema(const std::string& name, const std::string& fields,
                         const std::string& more = "");

// robostress_msgs/msg/TYPE: a header and a float64 for each name, so that a plot can ask for one.
McapSchema NumbersSchema(const std::string& type, const std::vector<std::string>& names);

// sensor_msgs/msg/CompressedImage: a header, "png", the file's bytes.
McapSchema CompressedImageSchema();

// Topics of a file in CDR; those of one type share its schema.
class McapTopics {
 public:
  explicit McapTopics(McapWriter* file) : file_(file) {}
  uint16_t Add(const std::string& topic, const McapSchema& schema);

 private:
  McapWriter* file_;
  std::map<std::string, uint16_t> schemas_;
};

}  // namespace robostress
