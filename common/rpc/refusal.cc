#include "common/rpc/refusal.h"

#include <algorithm>

#include "absl/strings/cord.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "proto/robostress/v1/policy.pb.h"

namespace robostress {
namespace {

constexpr char kRetryAfterMs[] = "robostress.v1.Refusal.retry_after_ms";
constexpr size_t kMaxMessage = 4096;

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

v1::Refusal ToProto(const absl::Status& status) {
  v1::Refusal message;
  message.set_code(static_cast<int>(status.code()));
  message.set_message(std::string(status.message().substr(0, kMaxMessage)));
  message.set_retry_after_ms(
      static_cast<uint32_t>(std::clamp<int64_t>(absl::ToInt64Milliseconds(RetryAfter(status)), 0,
                                                absl::ToInt64Milliseconds(absl::Hours(24)))));
  return message;
}

absl::Status FromProto(const v1::Refusal& message) {
  if (message.code() <= 0 || message.code() > 16) {
    return absl::InternalError(
        absl::StrCat("the server refused a prediction with code ", message.code(),
                     ", must be 1..16: ", message.message().substr(0, kMaxMessage)));
  }
  return Refusal(absl::Status(static_cast<absl::StatusCode>(message.code()),
                              message.message().substr(0, kMaxMessage)),
                 absl::Milliseconds(std::min(message.retry_after_ms(), 86'400'000u)));
}

}  // namespace robostress
