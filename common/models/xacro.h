#pragma once

#include "absl/status/status.h"
#include "common/models/xml_file.h"

namespace robostress {

// INVALID_ARGUMENT, with line and the command that expands it, of a file that holds what only ROS'
// macro language understands: elements xacro:..., expressions ${...} or $(...) in attributes. A
// namespace xmlns:xacro alone is what expanded files keep.
absl::Status RefuseXacro(const XmlFile& file);

}  // namespace robostress
