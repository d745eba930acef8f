#include "server/grpc_access.h"

#include <grpcpp/security/server_credentials.h>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {

std::string PeerCertificateOwner(const grpc::AuthContext& context) {
  const auto pem = context.FindPropertyValues("x509_pem_cert");
  if (!context.IsPeerAuthenticated() || pem.empty()) return "";
  return absl::StrCat("certificate:", Sha256Hex(std::string(pem[0].data(), pem[0].size())));
}

std::string HostOfPeer(const std::string& peer) {
  if (peer.rfind("unix", 0) == 0) return "unix";
  return peer.substr(0, peer.rfind(':'));
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
