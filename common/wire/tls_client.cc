#include "common/wire/tls_client.h"

#include <vector>

#include "common/status_macros.h"
#include "common/wire/tls_pem.h"

namespace robostress {

absl::StatusOr<std::shared_ptr<SSL_CTX>> MakeTlsClient(const ClientSecrets& secrets) {
  constexpr char kAuthority[] = "TLS authority", kCertificate[] = "TLS client certificate",
                 kKey[] = "TLS client key";
  std::shared_ptr<SSL_CTX> context(SSL_CTX_new(TLS_client_method()), &SSL_CTX_free);
  SSL_CTX_set_min_proto_version(context.get(), TLS1_2_VERSION);
  SSL_CTX_set_verify(context.get(), SSL_VERIFY_PEER, nullptr);
  if (secrets.authority.empty()) {
    if (SSL_CTX_set_default_verify_paths(context.get()) != 1)
      return absl::FailedPreconditionError("this system's TLS authorities cannot be read");
  } else {
    RS_ASSIGN_OR_RETURN(const std::vector<PemCertificate> authorities,
                        ReadCertificates(kAuthority, secrets.authority));
    RS_RETURN_IF_ERROR(TrustAuthorities(context.get(), kAuthority, authorities));
  }
  if (secrets.certificate.empty()) return context;
  RS_ASSIGN_OR_RETURN(const std::vector<PemCertificate> chain,
                      ReadCertificates(kCertificate, secrets.certificate));
  RS_ASSIGN_OR_RETURN(const PemKey key, ReadPrivateKey(kKey, secrets.key, chain.front().get(),
                                                       "the TLS client certificate"));
  RS_RETURN_IF_ERROR(ShowCertificate(context.get(), kCertificate, chain, kKey, key.get()));
  return context;
}

}  // namespace robostress
