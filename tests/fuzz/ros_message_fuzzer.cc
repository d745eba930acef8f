// A message definition, a NUL, and a message in CDR that is decoded by it.
#include <algorithm>

#include "common/recordings/joint_messages.h"
#include "tests/fuzz/fuzz_check.h"

namespace robostress {
namespace {

size_t ValuesIn(const CdrValue& value) {
  size_t count = value.numbers.size() + value.texts.size();
  for (const CdrValue& item : value.items) count += ValuesIn(item);
  return count;
}

}  // namespace
}  // namespace robostress

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  const absl::string_view input(reinterpret_cast<const char*>(data), size);
  const size_t end = std::min(input.find('\0'), input.size());
  const absl::string_view message = input.substr(std::min(end + 1, input.size()));
  const auto schema = RosSchema::Parse("sensor_msgs/msg/JointState", input.substr(0, end));
  if (!schema.ok()) {
    CheckRefusal(schema.status(), "schema of ");
    return 0;
  }
  const auto value = DecodeCdr(*schema, message);
  if (!value.ok()) {
    FuzzCheck(!value.status().message().empty(), "a refusal without a reason");
    return 0;
  }
  FuzzCheck(ValuesIn(*value) <= message.size(), "more values than bytes");
  for (const auto kind : {JointMessageKind::kJointState, JointMessageKind::kControllerState,
                          JointMessageKind::kTrajectory, JointMessageKind::kArray}) {
    const auto joints = ReadJointMessage(kind, *schema, *value);
    if (!joints.ok()) CheckRefusal(joints.status(), "field ");
  }
  return 0;
}
