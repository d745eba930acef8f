#pragma once

#include <grpcpp/security/auth_context.h>

#include <memory>
#include <string>

#include "server/operations/access_tokens.h"
#include "server/operations/tls_files.h"

namespace grpc {
class ServerCredentials;
}

namespace robostress {

// The address in a peer's name, as gRPC and the web ports write it, without its port: "127.0.0.1".
std::string HostOfPeer(const std::string& peer);

// CertificateOwner of what the client showed; empty: nothing. The same string as a WebRequest's
// certificate_owner for the same certificate.
std::string PeerCertificateOwner(const grpc::AuthContext& context);

// Every handshake uses what `tls` holds then; null: plain. Whether clients must show a certificate
// is decided now. The caller keeps what is returned until its server is gone.
std::shared_ptr<grpc::ServerCredentials> MakeServerCredentials(std::shared_ptr<const TlsStore> tls);

}  // namespace robostress
