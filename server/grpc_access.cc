#include "server/grpc_access.h"

#include <grpcpp/security/server_credentials.h>

#include <string_view>

#include "common/rpc/grpc_status.h"
#include "common/status_macros.h"

namespace robostress {

grpc::Status Authorize(const grpc::ServerContext& context, const AccessTokens& tokens,
                       Scope scope) {
  const auto found = context.client_metadata().find("authorization");
  const std::string_view shown = found == context.client_metadata().end()
                                     ? std::string_view()
                                     : std::string_view(found->second.data(), found->second.size());
  return ToGrpc(tokens.Check(shown, scope));
}

absl::StatusOr<std::shared_ptr<grpc::ServerCredentials>> MakeServerCredentials(
    const TlsFiles& files) {
  if (!files.enabled()) return grpc::InsecureServerCredentials();
  RS_ASSIGN_OR_RETURN(const TlsContents contents, ReadTlsFiles(files));
  grpc::SslServerCredentialsOptions options(
      contents.client_ca.empty() ? GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE
                                 : GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY);
  options.pem_root_certs = contents.client_ca;
  options.pem_key_cert_pairs.push_back({contents.key, contents.certificate});
  return grpc::SslServerCredentials(options);
}

}  // namespace robostress
