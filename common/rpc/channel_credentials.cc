#include "common/rpc/channel_credentials.h"

#include <grpcpp/security/credentials.h>

#include <cstdlib>
#include <map>
#include <string>
#include <utility>

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

// Shows the token in every call.
class TokenPlugin : public grpc::MetadataCredentialsPlugin {
 public:
  explicit TokenPlugin(std::string token) : token_(std::move(token)) {}
  grpc::Status GetMetadata(grpc::string_ref, grpc::string_ref, const grpc::AuthContext&,
                           std::multimap<grpc::string, grpc::string>* metadata) override {
    metadata->emplace("authorization", absl::StrCat("Bearer ", token_));
    return grpc::Status::OK;
  }
  bool IsBlocking() const override { return false; }
  grpc::string DebugString() override { return "token"; }  // never the token itself

 private:
  const std::string token_;
};

}  // namespace

absl::StatusOr<std::shared_ptr<grpc::ChannelCredentials>> ChannelCredentialsFromEnvironment() {
  grpc::SslCredentialsOptions options;
  RS_ASSIGN_OR_RETURN(options.pem_root_certs, FileOf("ROBOSTRESS_TLS_CA"));
  RS_ASSIGN_OR_RETURN(options.pem_cert_chain, FileOf("ROBOSTRESS_TLS_CERTIFICATE"));
  RS_ASSIGN_OR_RETURN(options.pem_private_key, FileOf("ROBOSTRESS_TLS_KEY"));
  RS_ASSIGN_OR_RETURN(std::string token, FileOf("ROBOSTRESS_TOKEN_FILE"));
  if (options.pem_root_certs.empty()) {
    if (!options.pem_cert_chain.empty() || !options.pem_private_key.empty() || !token.empty()) {
      return absl::InvalidArgumentError(
          "ROBOSTRESS_TLS_CERTIFICATE, ROBOSTRESS_TLS_KEY and ROBOSTRESS_TOKEN_FILE need "
          "ROBOSTRESS_TLS_CA: without TLS a token is readable on the way");
    }
    return grpc::InsecureChannelCredentials();
  }
  if (options.pem_cert_chain.empty() != options.pem_private_key.empty()) {
    return absl::InvalidArgumentError(
        "ROBOSTRESS_TLS_CERTIFICATE and ROBOSTRESS_TLS_KEY belong together; one is not set");
  }
  std::shared_ptr<grpc::ChannelCredentials> channel = grpc::SslCredentials(options);
  absl::StripAsciiWhitespace(&token);
  if (token.empty()) return channel;
  return grpc::CompositeChannelCredentials(
      channel,
      grpc::MetadataCredentialsFromPlugin(std::make_unique<TokenPlugin>(std::move(token))));
}

}  // namespace robostress
