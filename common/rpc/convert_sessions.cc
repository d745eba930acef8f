#include "common/rpc/convert_sessions.h"

#include <algorithm>
#include <string>

#include "common/rollout/field_checks.h"
#include "common/rollout/refusal.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr size_t kMaxRefusalMessage = 4096;
constexpr uint32_t kMaxRetryAfterMs = 24 * 3600 * 1000;

}  // namespace

robostress::v1::Priority ToProto(Priority priority) {
  switch (priority) {
    case Priority::kSimulation:
      return v1::PRIORITY_SIMULATION;
    case Priority::kRobot:
      return v1::PRIORITY_ROBOT;
    default:
      return v1::PRIORITY_UNSPECIFIED;
  }
}

absl::StatusOr<Priority> FromProto(robostress::v1::Priority message) {
  switch (message) {
    case v1::PRIORITY_UNSPECIFIED:
      return Priority::kUnspecified;
    case v1::PRIORITY_SIMULATION:
      return Priority::kSimulation;
    case v1::PRIORITY_ROBOT:
      return Priority::kRobot;
    default:
      return Invalid("priority is ", static_cast<int>(message),
                     ", must be UNSPECIFIED (0), SIMULATION (1) or ROBOT (2)");
  }
}

absl::Status ToStatus(const robostress::v1::Refusal& refusal) {
  const int code = refusal.code();
  if (code <= 0 || code > 16) return Invalid("refusal.code is ", code, ", must be 1 to 16");
  return Refusal(absl::Status(static_cast<absl::StatusCode>(code), refusal.message()),
                 absl::Milliseconds(std::min(refusal.retry_after_ms(), kMaxRetryAfterMs)));
}

robostress::v1::Refusal ToRefusal(const absl::Status& status) {
  v1::Refusal message;
  message.set_code(static_cast<int>(status.code()));
  message.set_message(std::string(status.message().substr(0, kMaxRefusalMessage)));
  const int64_t retry_ms = absl::ToInt64Milliseconds(RetryAfter(status));
  message.set_retry_after_ms(
      static_cast<uint32_t>(std::clamp<int64_t>(retry_ms, 0, kMaxRetryAfterMs)));
  return message;
}

robostress::v1::GetStatsResponse ToProto(const SessionStats& stats) {
  v1::GetStatsResponse message;
  message.set_feedback_chunks(stats.feedback_chunks);
  message.set_updates_applied(stats.updates_applied);
  message.set_adapter_distance(stats.adapter_distance);
  message.set_last_loss(stats.last_loss);
  return message;
}

absl::StatusOr<SessionStats> FromProto(const robostress::v1::GetStatsResponse& message) {
  RS_RETURN_IF_ERROR(CheckFinite("stats.adapter_distance", message.adapter_distance()));
  RS_RETURN_IF_ERROR(CheckFinite("stats.last_loss", message.last_loss()));
  SessionStats stats;
  stats.feedback_chunks = message.feedback_chunks();
  stats.updates_applied = message.updates_applied();
  stats.adapter_distance = message.adapter_distance();
  stats.last_loss = message.last_loss();
  return stats;
}

}  // namespace robostress
