#pragma once

#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// PEM files of one server. All empty: no TLS. With `client_ca` a client must show a certificate
// that it signed (mTLS).
struct TlsFiles {
  std::string certificate;  // chain, the server's own first
  std::string key;
  std::string client_ca;

  bool enabled() const { return !certificate.empty() || !key.empty() || !client_ca.empty(); }
};

// Contents of the files.
struct TlsContents {
  std::string certificate, key, client_ca;
};

// Reads and checks the files: INVALID_ARGUMENT names the file, and what is wrong: a certificate
// without a key or one that does not belong to it, no PEM, a key that others may read.
absl::StatusOr<TlsContents> ReadTlsFiles(const TlsFiles& files);

}  // namespace robostress
