#pragma once

#include <memory>

#include "absl/status/statusor.h"

namespace grpc {
class ChannelCredentials;
}

namespace robostress {

// How this process's clients speak to a policy server, from the environment, so that every program
// that opens a channel takes it alike and no secret stands on a command line:
//   ROBOSTRESS_TLS_CA            PEM file of the authority that signed the server's certificate;
//   unset:
//                                plain text
//   ROBOSTRESS_TLS_CERTIFICATE   PEM files of the client's own certificate and key, where the
//   server ROBOSTRESS_TLS_KEY           asks for one ROBOSTRESS_TOKEN_FILE        file that holds
//   the token; only with TLS, for it would be readable
//                                on the way
// INVALID_ARGUMENT names variable and file.
absl::StatusOr<std::shared_ptr<grpc::ChannelCredentials>> ChannelCredentialsFromEnvironment();

}  // namespace robostress
