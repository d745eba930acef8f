#include "server/edge/tls_files.h"

#include <openssl/bio.h>
#include <openssl/pem.h>
#include <openssl/x509.h>
#include <sys/stat.h>

#include <memory>

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

absl::StatusOr<Certificate> FirstCertificate(const std::string& file, const std::string& pem) {
  const Bio bio = Reader(pem);
  Certificate certificate(PEM_read_bio_X509(bio.get(), nullptr, nullptr, nullptr), &X509_free);
  if (certificate == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": holds no certificate in PEM form (-----BEGIN CERTIFICATE-----)"));
  }
  return certificate;
}

// A passphrase would be asked for on the terminal otherwise.
int NoPassphrase(char*, int, int, void*) { return 0; }

}  // namespace

absl::StatusOr<TlsContents> ReadTlsFiles(const TlsFiles& files) {
  if (files.certificate.empty() || files.key.empty()) {
    return absl::InvalidArgumentError(
        "TLS needs a certificate and its key: give --tls-certificate and --tls-key");
  }
  TlsContents contents;
  RS_ASSIGN_OR_RETURN(contents.certificate, ReadFileUpTo(files.certificate, kMaxPemBytes));
  RS_ASSIGN_OR_RETURN(contents.key, ReadFileUpTo(files.key, kMaxPemBytes));
  struct stat info {};
  if (stat(files.key.c_str(), &info) == 0 && (info.st_mode & S_IRWXO) != 0) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "%s: everybody may open this key (mode %o); chmod 600 it", files.key, info.st_mode & 0777));
  }
  RS_ASSIGN_OR_RETURN(const Certificate certificate,
                      FirstCertificate(files.certificate, contents.certificate));
  const Bio bio = Reader(contents.key);
  const Key key(PEM_read_bio_PrivateKey(bio.get(), nullptr, &NoPassphrase, nullptr),
                &EVP_PKEY_free);
  if (key == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrCat(files.key, ": holds no private key in PEM form without a passphrase"));
  }
  if (X509_check_private_key(certificate.get(), key.get()) != 1) {
    return absl::InvalidArgumentError(
        absl::StrCat(files.key, ": is not the key of the certificate in ", files.certificate));
  }
  if (!files.client_ca.empty()) {
    RS_ASSIGN_OR_RETURN(contents.client_ca, ReadFileUpTo(files.client_ca, kMaxPemBytes));
    RS_RETURN_IF_ERROR(FirstCertificate(files.client_ca, contents.client_ca).status());
  }
  return contents;
}

}  // namespace robostress
