#include "common/wire/tls_pem.h"

#include <openssl/bio.h>
#include <openssl/err.h>
#include <openssl/pem.h>
#include <openssl/x509.h>

#include <cstddef>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"

namespace robostress {
namespace {

using Bio = std::unique_ptr<BIO, decltype(&BIO_free)>;

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

absl::Status Refused(const std::string& source) {
  return absl::InvalidArgumentError(absl::StrCat(source, ": cannot be used: ", LastReason()));
}

// A passphrase would be asked for on the terminal otherwise.
int NoPassphrase(char*, int, int, void*) { return 0; }

}  // namespace

absl::StatusOr<std::vector<PemCertificate>> ReadCertificates(const std::string& source,
                                                             const std::string& pem) {
  const Bio bio = Reader(pem);
  std::vector<PemCertificate> certificates;
  ERR_clear_error();
  while (X509* next = PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr))
    certificates.emplace_back(next, &X509_free);
  const bool at_end = ERR_GET_REASON(ERR_peek_last_error()) == PEM_R_NO_START_LINE;
  const std::string reason = LastReason();
  if (certificates.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(source, ": holds no certificate in PEM form (-----BEGIN CERTIFICATE-----)"));
  }
  if (!at_end) {
    return absl::InvalidArgumentError(absl::StrCat(source, ": certificate ",
                                                   certificates.size() + 1,
                                                   " of it is broken or cut off: ", reason));
  }
  return certificates;
}

absl::StatusOr<PemKey> ReadPrivateKey(const std::string& source, const std::string& pem,
                                      const X509* certificate,
                                      const std::string& certificate_source) {
  const Bio bio = Reader(pem);
  PemKey key(PEM_read_bio_PrivateKey(bio.get(), nullptr, &NoPassphrase, nullptr), &EVP_PKEY_free);
  ERR_clear_error();
  if (key == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat(source, ": holds no private key in PEM form without a passphrase"));
  }
  if (X509_check_private_key(certificate, key.get()) != 1) {
    ERR_clear_error();
    return absl::InvalidArgumentError(
        absl::StrCat(source, ": is not the key of the certificate in ", certificate_source));
  }
  return key;
}

absl::Status ShowCertificate(SSL_CTX* context, const std::string& source,
                             const std::vector<PemCertificate>& chain,
                             const std::string& key_source, EVP_PKEY* key) {
  if (SSL_CTX_use_certificate(context, chain.front().get()) != 1) return Refused(source);
  for (size_t i = 1; i < chain.size(); ++i) {
    if (SSL_CTX_add1_chain_cert(context, chain[i].get()) != 1) return Refused(source);
  }
  return SSL_CTX_use_PrivateKey(context, key) == 1 ? absl::OkStatus() : Refused(key_source);
}

absl::Status TrustAuthorities(SSL_CTX* context, const std::string& source,
                              const std::vector<PemCertificate>& authorities) {
  for (const PemCertificate& authority : authorities) {
    if (X509_STORE_add_cert(SSL_CTX_get_cert_store(context), authority.get()) != 1)
      return Refused(source);
  }
  return absl::OkStatus();
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
  const PemCertificate certificate(PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr),
                                   &X509_free);
  ERR_clear_error();
  return CertificateOwner(certificate.get());
}

}  // namespace robostress
