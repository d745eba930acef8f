#pragma once

#include <grpcpp/security/auth_context.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/edge/access_tokens.h"
#include "server/edge/tls_files.h"

namespace grpc {
class ServerCredentials;
}

namespace robostress {

// "certificate:" and the SHA-256 of the PEM that the peer showed; empty: none.
std::string PeerCertificateOwner(const grpc::AuthContext& context);
// The address in a peer's name without its port: "ipv4:127.0.0.1".
std::string HostOfPeer(const std::string& peer);

// Plain where no file is named.
absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsFiles& files);

}  // namespace robostress
