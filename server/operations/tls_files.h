#pragma once

#include <openssl/ssl.h>

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/operations/published.h"

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
  bool operator==(const TlsContents&) const = default;
};

// What a server shows and asks for: contents that were checked.
struct TlsSnapshot {
  TlsContents contents;
  absl::Time not_after;  // the server's own certificate is valid until then
  // Of a server: TLS 1.2 or later, no session tickets, so that every connection shows its
  // certificate to the authority of now.
  std::shared_ptr<SSL_CTX> context;
};

// Reads and checks the files: INVALID_ARGUMENT names the file, and what is wrong: a certificate
// without a key or one that does not belong to it, no PEM or half of one, a key that others may
// read, a strength that this system refuses.
absl::StatusOr<TlsSnapshot> ReadTlsFiles(const TlsFiles& files);

// The certificates of a running server, for all of its ports: replaced when the files change.
// Connections that are open keep what they were opened with.
using TlsStore = Published<TlsSnapshot>;
// Of the files as they are now.
absl::StatusOr<std::shared_ptr<TlsStore>> LoadTls(const TlsFiles& files);

}  // namespace robostress
