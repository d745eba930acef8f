#pragma once

#include <string>

#include "absl/status/statusor.h"

namespace robostress {

// What a client of a policy server trusts and shows: contents of files, never their names. None: it
// trusts this system's authorities and shows nothing.
struct ClientSecrets {
  std::string authority;         // PEM of what signed the server's certificate
  std::string certificate, key;  // PEM of the client's own, where the server asks for one
  std::string token;             // readable on the way without TLS
};

// From the files that the environment names, so that every program takes them alike, over every
// wire, and no secret stands on a command line: ROBOSTRESS_TLS_CA, ROBOSTRESS_TLS_CERTIFICATE and
// ROBOSTRESS_TLS_KEY (both or none), ROBOSTRESS_TOKEN_FILE. INVALID_ARGUMENT names variable and
// file.
absl::StatusOr<ClientSecrets> ClientSecretsFromEnvironment();

}  // namespace robostress
