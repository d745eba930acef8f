#include "common/client_secrets.h"

#include <cstdint>
#include <cstdlib>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint64_t kMaxBytes = 1 << 20;

// Contents of the file that a variable names; empty where it is not set.
absl::StatusOr<std::string> FileOf(const char* variable) {
  const char* file = std::getenv(variable);
  if (file == nullptr || *file == '\0') return std::string();
  absl::StatusOr<std::string> contents = ReadFileUpTo(file, kMaxBytes);
  if (!contents.ok() || contents->empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        variable, "=", file, ": ", contents.ok() ? "is empty" : contents.status().message()));
  }
  return contents;
}

}  // namespace

absl::StatusOr<ClientSecrets> ClientSecretsFromEnvironment() {
  ClientSecrets secrets;
  RS_ASSIGN_OR_RETURN(secrets.authority, FileOf("ROBOSTRESS_TLS_CA"));
  RS_ASSIGN_OR_RETURN(secrets.certificate, FileOf("ROBOSTRESS_TLS_CERTIFICATE"));
  RS_ASSIGN_OR_RETURN(secrets.key, FileOf("ROBOSTRESS_TLS_KEY"));
  RS_ASSIGN_OR_RETURN(secrets.token, FileOf("ROBOSTRESS_TOKEN_FILE"));
  if (secrets.certificate.empty() != secrets.key.empty()) {
    return absl::InvalidArgumentError(
        "ROBOSTRESS_TLS_CERTIFICATE and ROBOSTRESS_TLS_KEY belong together; one is not set");
  }
  absl::StripAsciiWhitespace(&secrets.token);
  return secrets;
}

}  // namespace robostress
