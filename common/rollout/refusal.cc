#include "common/rollout/refusal.h"

#include <algorithm>

#include "absl/strings/cord.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

constexpr char kRetryAfterMs[] = "robostress.v1.Refusal.retry_after_ms";

}  // namespace

absl::Status Refusal(absl::Status status, absl::Duration retry_after) {
  status.SetPayload(kRetryAfterMs,
                    absl::Cord(absl::StrCat(absl::ToInt64Milliseconds(retry_after))));
  return status;
}

absl::Status OverloadedError(const std::string& message, absl::Duration retry_after) {
  const absl::Duration after = std::max(absl::Milliseconds(1), retry_after);
  return Refusal(absl::ResourceExhaustedError(absl::StrCat(
                     message, "; come back in ", absl::ToInt64Milliseconds(after), " ms")),
                 after);
}

bool IsRefusal(const absl::Status& status) { return status.GetPayload(kRetryAfterMs).has_value(); }

absl::Duration RetryAfter(const absl::Status& status) {
  const auto payload = status.GetPayload(kRetryAfterMs);
  int64_t ms = 0;
  if (!payload || !absl::SimpleAtoi(std::string(*payload), &ms)) return absl::ZeroDuration();
  return absl::Milliseconds(ms);
}

}  // namespace robostress
