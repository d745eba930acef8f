#pragma once

#include <grpcpp/server_context.h>
#include <grpcpp/support/status.h>

#include <memory>
#include <string>

#include "server/edge/access_tokens.h"
#include "server/edge/tls_files.h"

namespace grpc {
class ServerCredentials;
}

namespace robostress {

// The metadata entry "authorization" (AccessTokens::Authenticate) must carry a token with `scope`.
// Asked first by every handler, so that an attempt without rights changes nothing.
grpc::Status Authorize(const grpc::ServerContextBase& context, const AccessTokens& tokens,
                       Scope scope);

// CertificateOwner of what the client showed; empty: nothing. The same string as a WebRequest's
// certificate_owner for the same certificate.
std::string PeerCertificateOwner(const grpc::AuthContext& context);

// Every handshake uses what `tls` holds then; null: plain. Whether clients must show a certificate
// is decided now. The caller keeps what is returned until its server is gone.
std::shared_ptr<grpc::ServerCredentials> MakeServerCredentials(std::shared_ptr<const TlsStore> tls);

}  // namespace robostress
