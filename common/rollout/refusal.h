#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/time/time.h"

namespace robostress {

// A prediction that a server chose not to compute, though session and request are in order: it is
// overloaded, the deadline cannot be kept, or a newer observation came. The mark and the time to
// come back travel with the status, on the wire as v1.Refusal (common/rpc).

// `status` with the mark.
absl::Status Refusal(absl::Status status, absl::Duration retry_after = absl::ZeroDuration());
// RESOURCE_EXHAUSTED with the mark; the message says when to come back.
absl::Status OverloadedError(const std::string& message, absl::Duration retry_after);

// Trailing metadata of a call that ends with a refusal: v1.Refusal, serialised.
inline constexpr char kRefusalMetadata[] = "robostress-refusal-bin";

bool IsRefusal(const absl::Status& status);
// Not before this; zero where nothing is said.
absl::Duration RetryAfter(const absl::Status& status);

}  // namespace robostress
