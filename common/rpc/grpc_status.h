#pragma once

#include <grpcpp/support/status.h>

#include "absl/status/status.h"

namespace robostress {

// Largest message [bytes]: an exported adapter with its buffer of observations. What a server takes
// and sends unless it is told otherwise, and what it may be told at most, which clients take.
inline constexpr int kMaxMessageBytes = 256 << 20;
inline constexpr int kLargestMessageBytes = 1 << 30;

// The two libraries number their codes alike; messages are kept (gRPC's are cut to 4 KB, its header
// limit is 8 KB).
grpc::Status ToGrpc(const absl::Status& status);
absl::Status FromGrpc(const grpc::Status& status);

}  // namespace robostress
