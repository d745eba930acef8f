#pragma once

#include <openssl/ssl.h>

#include <memory>

#include "absl/status/statusor.h"
#include "common/client_secrets.h"

namespace robostress {

// How a client opens TLS: version 1.2 or later, the server's certificate signed by
// `secrets.authority` (none: by one of this system's), the client's own shown where there is one.
// The token is no part of it. INVALID_ARGUMENT says what is wrong with which.
absl::StatusOr<std::shared_ptr<SSL_CTX>> MakeTlsClient(const ClientSecrets& secrets);

}  // namespace robostress
