#include "common/rollout/message_limits.h"

namespace robostress {
namespace {

// A number as msgpack and protobuf write it where it stands alone: a tag and a float64.
constexpr size_t kNumberBytes = 9;
// Names, shapes and types of one view or array; what a session says of itself.
constexpr size_t kFieldBytes = 2 * WireLimits::kName, kSessionBytes = WireLimits::kMethodYaml;

size_t Size(int n) { return static_cast<size_t>(n); }

}  // namespace

size_t LargestObservationBytes(const PolicySpec& policy, int max_view_side, size_t value_bytes) {
  const size_t view = 3 * value_bytes * Size(max_view_side) * Size(max_view_side);
  return policy.cameras.size() * (view + kFieldBytes) + kNumberBytes * Size(policy.state_dim) +
         WireLimits::kInstruction + kFieldBytes + kSessionBytes +
         kNumberBytes * Size(policy.horizon) * Size(policy.action_dim) + kFieldBytes;  // running
}

size_t LargestExecutedBytes(const PolicySpec& policy) {
  constexpr size_t kPose = 7, kStampAndGripper = 2, kArrays = 16, kCommands = 3;
  const size_t state = 2 * WireLimits::kDof + kPose + kStampAndGripper;
  const size_t step = state + kCommands * Size(policy.action_dim);
  return kNumberBytes * step * Size(policy.horizon + 1) + kArrays * kFieldBytes;
}

}  // namespace robostress
