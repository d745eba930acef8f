#include "server/operations/tls_files.h"

#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <sys/stat.h>

#include <ctime>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint64_t kMaxPemBytes = 1 << 20;

using Bio = std::unique_ptr<BIO, decltype(&BIO_free)>;
using Certificate = std::unique_ptr<X509, decltype(&X509_free)>;
using Key = std::unique_ptr<EVP_PKEY, decltype(&EVP_PKEY_free)>;

Bio Reader(const std::string& text) {
  return Bio(BIO_new_mem_buf(text.data(), static_cast<int>(text.size())), &BIO_free);
}

// The reason that OpenSSL gave last; forgets all of them.
std::string LastReason() {
  const unsigned long error = ERR_peek_last_error();
  ERR_clear_error();
  const char* reason = ERR_reason_error_string(error);
  return reason == nullptr ? "OpenSSL gives no reason" : reason;
}

// All certificates of a file, at least one. A file that ends within one is refused: it is being
// written.
absl::StatusOr<std::vector<Certificate>> Certificates(const std::string& file,
                                                      const std::string& pem) {
  const Bio bio = Reader(pem);
  std::vector<Certificate> certificates;
  ERR_clear_error();
  while (X509* next = PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr))
    certificates.emplace_back(next, &X509_free);
  const bool at_end = ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  const std::string reason = LastReason();
  if (certificates.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": holds no certificate in PEM form (-----BEGIN CERTIFICATE-----)"));
  }
  if (!at_end) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": certificate ", certificates.size() + 1,
                                                   " of it is broken or cut off: ", reason));
  }
  return certificates;
}

// A passphrase would be asked for on the terminal otherwise.
int NoPassphrase(char*, int, int, void*) { return 0; }

absl::StatusOr<std::shared_ptr<SSL_CTX>> MakeContext(const TlsFiles& files,
                                                     const std::vector<Certificate>& chain,
                                                     EVP_PKEY* key,
                                                     const std::vector<Certificate>& authorities) {
  const auto refuse = [](const std::string& file) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": cannot be used: ", LastReason()));
  };
  std::shared_ptr<SSL_CTX> context(SSL_CTX_new(TLS_server_method()), &SSL_CTX_free);
  SSL_CTX_set_min_proto_version(context.get(), TLS1_2_VERSION);
  SSL_CTX_set_options(context.get(), SSL_OP_ALL | SSL_OP_NO_TICKET);
  SSL_CTX_set_session_cache_mode(context.get(), SSL_SESS_CACHE_OFF);
  SSL_CTX_set_num_tickets(context.get(), 0);
  if (SSL_CTX_use_certificate(context.get(), chain.front().get()) != 1)
    return refuse(files.certificate);
  for (size_t i = 1; i < chain.size(); ++i) {
    if (SSL_CTX_add1_chain_cert(context.get(), chain[i].get()) != 1)
      return refuse(files.certificate);
  }
  if (SSL_CTX_use_PrivateKey(context.get(), key) != 1) return refuse(files.key);
  for (const Certificate& authority : authorities) {
    if (X509_STORE_add_cert(SSL_CTX_get_cert_store(context.get()), authority.get()) != 1)
      return refuse(files.client_ca);
    SSL_CTX_add_client_CA(context.get(), authority.get());
  }
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
  RS_ASSIGN_OR_RETURN(const std::vector<Certificate> chain,
                      Certificates(files.certificate, contents.certificate));
  const Bio bio = Reader(contents.key);
  const Key key(PEM_read_bio_PrivateKey(bio.get(), nullptr, &NoPassphrase, nullptr),
                &EVP_PKEY_free);
  ERR_clear_error();
  if (key == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat(files.key, ": holds no private key in PEM form without a passphrase"));
  }
  if (X509_check_private_key(chain.front().get(), key.get()) != 1) {
    ERR_clear_error();
    return absl::InvalidArgumentError(
        absl::StrCat(files.key, ": is not the key of the certificate in ", files.certificate));
  }
  std::vector<Certificate> authorities;
  if (!files.client_ca.empty()) {
    RS_ASSIGN_OR_RETURN(contents.client_ca, ReadFileUpTo(files.client_ca, kMaxPemBytes));
    RS_ASSIGN_OR_RETURN(authorities, Certificates(files.client_ca, contents.client_ca));
  }
  snapshot.not_after = NotAfter(chain.front().get());
  RS_ASSIGN_OR_RETURN(snapshot.context, MakeContext(files, chain, key.get(), authorities));
  return snapshot;
}

std::string CertificateOwner(const X509* certificate) {
  if (certificate == nullptr) return "";
  unsigned char* der = nullptr;
  const int size = i2d_X509(certificate, &der);
  if (size <= 0) return "";
  const std::string digest =
      Sha256Hex({reinterpret_cast<const char*>(der), static_cast<size_t>(size)});
  OPENSSL_free(der);
  return absl::StrCat("certificate:", digest);
}

std::string CertificateOwnerOfPem(const std::string& pem) {
  const Bio bio = Reader(pem);
  const Certificate certificate(PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr),
                                &X509_free);
  ERR_clear_error();
  return CertificateOwner(certificate.get());
}

absl::StatusOr<std::shared_ptr<TlsStore>> LoadTls(const TlsFiles& files) {
  RS_ASSIGN_OR_RETURN(TlsSnapshot snapshot, ReadTlsFiles(files));
  return std::make_shared<TlsStore>(std::move(snapshot));
}

}  // namespace robostress
