#include "server/operations/tls_files.h"

#include <openssl/x509.h>
#include <sys/stat.h>

#include <ctime>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "common/wire/tls_pem.h"

namespace robostress {
namespace {

constexpr uint64_t kMaxPemBytes = 1 << 20;

absl::StatusOr<std::shared_ptr<SSL_CTX>> MakeContext(
    const TlsFiles& files, const std::vector<PemCertificate>& chain, EVP_PKEY* key,
    const std::vector<PemCertificate>& authorities) {
  std::shared_ptr<SSL_CTX> context(SSL_CTX_new(TLS_server_method()), &SSL_CTX_free);
  SSL_CTX_set_min_proto_version(context.get(), TLS1_2_VERSION);
  SSL_CTX_set_options(context.get(), SSL_OP_ALL | SSL_OP_NO_TICKET);
  SSL_CTX_set_session_cache_mode(context.get(), SSL_SESS_CACHE_OFF);
  SSL_CTX_set_num_tickets(context.get(), 0);
  RS_RETURN_IF_ERROR(ShowCertificate(context.get(), files.certificate, chain, files.key, key));
  RS_RETURN_IF_ERROR(TrustAuthorities(context.get(), files.client_ca, authorities));
  for (const PemCertificate& authority : authorities)
    SSL_CTX_add_client_CA(context.get(), authority.get());
  if (!authorities.empty()) {
    SSL_CTX_set_verify(context.get(), SSL_VERIFY_PEER | SSL_VERIFY_FAIL_IF_NO_PEER_CERT, nullptr);
  }
  return context;
}

absl::Time NotAfter(const X509* certificate) {
  tm utc{};
  ASN1_TIME_to_tm(X509_get0_notAfter(certificate), &utc);
  return absl::FromTimeT(timegm(&utc));
}

}  // namespace

absl::StatusOr<TlsSnapshot> ReadTlsFiles(const TlsFiles& files) {
  if (files.certificate.empty() || files.key.empty()) {
    return absl::InvalidArgumentError(
        "TLS needs a certificate and its key: give --tls-certificate and --tls-key");
  }
  TlsSnapshot snapshot;
  TlsContents& contents = snapshot.contents;
  RS_ASSIGN_OR_RETURN(contents.certificate, ReadFileUpTo(files.certificate, kMaxPemBytes));
  RS_ASSIGN_OR_RETURN(contents.key, ReadFileUpTo(files.key, kMaxPemBytes));
  // The group may read it: systemd's credentials (0440) and a pod's secrets are given that way.
  struct stat info {};
  if (stat(files.key.c_str(), &info) == 0 && (info.st_mode & S_IRWXO) != 0) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "%s: everybody may open this key (mode %o); chmod 600 it", files.key, info.st_mode & 0777));
  }
  RS_ASSIGN_OR_RETURN(const std::vector<PemCertificate> chain,
                      ReadCertificates(files.certificate, contents.certificate));
  RS_ASSIGN_OR_RETURN(const PemKey key, ReadPrivateKey(files.key, contents.key, chain.front().get(),
                                                       files.certificate));
  std::vector<PemCertificate> authorities;
  if (!files.client_ca.empty()) {
    RS_ASSIGN_OR_RETURN(contents.client_ca, ReadFileUpTo(files.client_ca, kMaxPemBytes));
    RS_ASSIGN_OR_RETURN(authorities, ReadCertificates(files.client_ca, contents.client_ca));
  }
  snapshot.not_after = NotAfter(chain.front().get());
  RS_ASSIGN_OR_RETURN(snapshot.context, MakeContext(files, chain, key.get(), authorities));
  return snapshot;
}

absl::StatusOr<std::shared_ptr<TlsStore>> LoadTls(const TlsFiles& files) {
  RS_ASSIGN_OR_RETURN(TlsSnapshot snapshot, ReadTlsFiles(files));
  return std::make_shared<TlsStore>(std::move(snapshot));
}

}  // namespace robostress
