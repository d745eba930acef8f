#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/status.h>

#include <memory>

#include "absl/status/statusor.h"
#include "server/edge/access_tokens.h"
#include "server/edge/tls_files.h"

namespace grpc {
class ServerCredentials;
}

namespace robostress {

// The metadata entry "authorization" (AccessTokens::Authenticate) must carry a token with `scope`.
// Asked first by every handler, so that an attempt without rights changes nothing.
grpc::Status Authorize(const grpc::ServerContext& context, const AccessTokens& tokens, Scope scope);

// Plain where no file is named.
absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsFiles& files);

}  // namespace robostress
