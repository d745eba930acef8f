#include "eval/export/mcap_topics.h"

#include "absl/strings/str_cat.h"

namespace robostress {

std::string RosDefinition(absl::string_view type, absl::string_view text) {
  return absl::StrCat(std::string(80, '='), "\nMSG: ", type, "\n", text);
}

McapSchema StampedSchema(const std::string& name, const std::string& fields,
                         const std::string& more) {
  return {name, "ros2msg",
          absl::StrCat(
              "std_msgs/Header header\n", fields, more,
              RosDefinition("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"),
              RosDefinition("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n"))};
}

McapSchema NumbersSchema(const std::string& type, const std::vector<std::string>& names) {
  std::string fields;
  for (const std::string& name : names) absl::StrAppend(&fields, "float64 ", name, "\n");
  return StampedSchema(absl::StrCat("robostress_msgs/msg/", type), fields);
}

McapSchema CompressedImageSchema() {
  return StampedSchema("sensor_msgs/msg/CompressedImage", "string format\nuint8[] data\n");
}

uint16_t McapTopics::Add(const std::string& topic, const McapSchema& schema) {
  const auto [known, is_new] = schemas_.try_emplace(schema.name, 0);
  if (is_new) known->second = file_->AddSchema(schema);
  return file_->AddChannel({topic, "cdr", known->second});
}

}  // namespace robostress
