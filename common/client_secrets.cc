#include "common/client_secrets.h"

#include <sys/stat.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "spdlog/spdlog.h"

namespace robostress {
namespace {

constexpr uint64_t kMaxBytes = 1 << 20;
constexpr char kTokenFile[] = "ROBOSTRESS_TOKEN_FILE";

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

// The one word that the token's file holds, without the line's end.
absl::Status TakeToken(std::string& token) {
  if (token.empty()) return absl::OkStatus();
  absl::StripAsciiWhitespace(&token);
  const bool word = std::all_of(token.begin(), token.end(), absl::ascii_isgraph);
  if (!token.empty() && word) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(kTokenFile, "=", std::getenv(kTokenFile), ": ",
                   token.empty() ? "is empty" : "holds more than one word, or what is not ASCII",
                   "; put the server's token into it, on one line"));
}

void WarnOfOpenFile(const char* variable) {
  const char* file = std::getenv(variable);
  struct stat info {};
  if (file == nullptr || *file == '\0' || stat(file, &info) != 0) return;
  if ((info.st_mode & S_IRWXO) == 0) return;
  spdlog::warn("{}={}: everybody on this machine may open it (mode {:o}); chmod 600 it", variable,
               file, info.st_mode & 0777);
}

}  // namespace

absl::StatusOr<ClientSecrets> ClientSecretsFromEnvironment() {
  ClientSecrets secrets;
  RS_ASSIGN_OR_RETURN(secrets.authority, FileOf("ROBOSTRESS_TLS_CA"));
  RS_ASSIGN_OR_RETURN(secrets.certificate, FileOf("ROBOSTRESS_TLS_CERTIFICATE"));
  RS_ASSIGN_OR_RETURN(secrets.key, FileOf("ROBOSTRESS_TLS_KEY"));
  RS_ASSIGN_OR_RETURN(secrets.token, FileOf(kTokenFile));
  if (secrets.certificate.empty() != secrets.key.empty()) {
    return absl::InvalidArgumentError(
        "ROBOSTRESS_TLS_CERTIFICATE and ROBOSTRESS_TLS_KEY belong together; one is not set");
  }
  RS_RETURN_IF_ERROR(TakeToken(secrets.token));
  for (const char* variable : {kTokenFile, "ROBOSTRESS_TLS_KEY"}) WarnOfOpenFile(variable);
  return secrets;
}

}  // namespace robostress
