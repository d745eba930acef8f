#pragma once

#include <memory>

#include "absl/status/statusor.h"

namespace grpc {
class ChannelCredentials;
}

namespace robostress {

// How this process's clients speak to a policy server, by common/client_secrets.h: plain text
// without ROBOSTRESS_TLS_CA, and then without a token too. INVALID_ARGUMENT names variable and
// file.
absl::StatusOr<std::shared_ptr<grpc::ChannelCredentials>> ChannelCredentialsFromEnvironment();

}  // namespace robostress
