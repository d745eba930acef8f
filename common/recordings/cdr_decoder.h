#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/recordings/ros_schema.h"

namespace robostress {

// A decoded value. Of a struct `items` are its fields, in the order of RosType::fields; of an array
// of structs its entries. Numbers (bools, too) are in `numbers`, strings in `texts`: one, or those
// of an array.
struct CdrValue {
  std::vector<double> numbers;
  std::vector<std::string> texts;
  std::vector<CdrValue> items;
};

// A message of ROS 2 in CDR (OMG DDS-XTypes 1.3, 7.4): four bytes of encapsulation, then the
// fields, each aligned to its size from the fifth byte on; in XCDR1 up to 8, in XCDR2 up to 4. Both
// byte orders. INVALID_ARGUMENT names field, value and limit; a count is believed only as far as
// the bytes reach, and no message becomes more than a million values.
absl::StatusOr<CdrValue> DecodeCdr(const RosSchema& schema, absl::string_view message);

}  // namespace robostress
