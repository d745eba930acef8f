#pragma once

#include <openssl/ssl.h>

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

// Certificates and keys in PEM form, checked, for either side of a connection.
namespace robostress {

using PemCertificate = std::unique_ptr<X509, decltype(&X509_free)>;
using PemKey = std::unique_ptr<EVP_PKEY, decltype(&EVP_PKEY_free)>;

// All certificates of a text, at least one; one that ends within a certificate is refused: it is
// being written. `source` names it in errors, which are INVALID_ARGUMENT.
absl::StatusOr<std::vector<PemCertificate>> ReadCertificates(const std::string& source,
                                                             const std::string& pem);
// The key of `certificate`, without a passphrase. `certificate_source` as `source`.
absl::StatusOr<PemKey> ReadPrivateKey(const std::string& source, const std::string& pem,
                                      const X509* certificate,
                                      const std::string& certificate_source);

// Shows `chain`, its own certificate first, with its key. INVALID_ARGUMENT names the source, and
// why this system refuses it.
absl::Status ShowCertificate(SSL_CTX* context, const std::string& source,
                             const std::vector<PemCertificate>& chain,
                             const std::string& key_source, EVP_PKEY* key);
// Trusts what `authorities` signed. Errors as above.
absl::Status TrustAuthorities(SSL_CTX* context, const std::string& source,
                              const std::vector<PemCertificate>& authorities);

// Who shows this certificate: "certificate:" and the SHA-256 of its DER form in hex. Null and what
// is no PEM: empty.
std::string CertificateOwner(const X509* certificate);
std::string CertificateOwnerOfPem(const std::string& pem);

}  // namespace robostress
