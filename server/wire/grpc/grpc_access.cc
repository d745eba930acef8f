#include "server/wire/grpc/grpc_access.h"

#include <grpc/grpc.h>
#include <grpc/grpc_security.h>
#include <grpcpp/security/auth_context.h>
#include <grpcpp/security/server_credentials.h>

#include <list>
#include <utility>

#include "absl/strings/str_replace.h"
#include "common/check.h"
#include "common/wire/tls_pem.h"

namespace robostress {
namespace {

// gRPC's own SslServerCredentials keep the certificate that they were made with. The C core asks
// for it before every handshake; this hands that to a ServerBuilder.
class ReloadingCredentials final : public grpc::ServerCredentials {
 public:
  explicit ReloadingCredentials(std::shared_ptr<const TlsStore> tls) : tls_(std::move(tls)) {}

  // Of handlers that see a call's metadata first; ours ask in the service (Authorize).
  void SetAuthMetadataProcessor(
      const std::shared_ptr<grpc::AuthMetadataProcessor>& processor) override {
    RS_CHECK(processor == nullptr);
  }

 private:
  // What the core holds for one port.
  struct Port {
    const TlsStore* tls;
    uint64_t fetched = 0;  // generation
  };

  int AddPortToServer(const std::string& address, grpc_server* server) override {
    const auto clients = tls_->Get()->contents.client_ca.empty()
                             ? GRPC_SSL_DONT_REQUEST_CLIENT_CERTIFICATE
                             : GRPC_SSL_REQUEST_AND_REQUIRE_CLIENT_CERTIFICATE_AND_VERIFY;
    Port& port = ports_.emplace_back(Port{tls_.get()});
    grpc_server_credentials* const core = grpc_ssl_server_credentials_create_with_options(
        grpc_ssl_server_credentials_create_options_using_config_fetcher(clients, &Fetch, &port));
    const int number = grpc_server_add_http2_port(server, address.c_str(), core);
    grpc_server_credentials_release(core);  // the server holds it
    return number;
  }

  // Called by one thread at a time, under the core's lock of this port.
  static grpc_ssl_certificate_config_reload_status Fetch(
      void* data, grpc_ssl_server_certificate_config** config) {
    auto& port = *static_cast<Port*>(data);
    const uint64_t generation = port.tls->generation();
    if (generation == port.fetched) return GRPC_SSL_CERTIFICATE_CONFIG_RELOAD_UNCHANGED;
    const std::shared_ptr<const TlsSnapshot> tls = port.tls->Get();
    const TlsContents& contents = tls->contents;
    const grpc_ssl_pem_key_cert_pair pair = {contents.key.c_str(), contents.certificate.c_str()};
    // The core wants an authority even where clients are asked for nothing.
    const std::string& authority =
        contents.client_ca.empty() ? contents.certificate : contents.client_ca;
    *config = grpc_ssl_server_certificate_config_create(authority.c_str(), &pair, 1);
    port.fetched = generation;
    return GRPC_SSL_CERTIFICATE_CONFIG_RELOAD_NEW;
  }

  const std::shared_ptr<const TlsStore> tls_;
  std::list<Port> ports_;  // their addresses are the core's
};

}  // namespace

std::string HostOfPeer(const std::string& peer) {
  if (peer.rfind("unix", 0) == 0) return "unix";
  return absl::StrReplaceAll(
      peer.substr(0, peer.rfind(':')),
      {{"ipv4:", ""}, {"ipv6:", ""}, {"%5B", ""}, {"%5D", ""}, {"[", ""}, {"]", ""}});
}

std::string PeerCertificateOwner(const grpc::AuthContext& context) {
  const std::vector<grpc::string_ref> shown =
      context.FindPropertyValues(GRPC_X509_PEM_CERT_PROPERTY_NAME);
  if (shown.size() != 1) return "";
  return CertificateOwnerOfPem(std::string(shown[0].data(), shown[0].size()));
}

std::shared_ptr<grpc::ServerCredentials> MakeServerCredentials(
    std::shared_ptr<const TlsStore> tls) {
  if (tls == nullptr) return grpc::InsecureServerCredentials();
  return std::make_shared<ReloadingCredentials>(std::move(tls));
}

}  // namespace robostress
