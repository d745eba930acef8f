#include "common/rpc/channel_credentials.h"

#include <grpcpp/security/credentials.h>

#include <map>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/client_secrets.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

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
  RS_ASSIGN_OR_RETURN(ClientSecrets secrets, ClientSecretsFromEnvironment());
  if (secrets.authority.empty()) {
    if (!secrets.certificate.empty() || !secrets.token.empty()) {
      return absl::InvalidArgumentError(
          "ROBOSTRESS_TLS_CERTIFICATE, ROBOSTRESS_TLS_KEY and ROBOSTRESS_TOKEN_FILE need "
          "ROBOSTRESS_TLS_CA: without TLS a token is readable on the way");
    }
    return grpc::InsecureChannelCredentials();
  }
  const grpc::SslCredentialsOptions options{secrets.authority, secrets.key, secrets.certificate};
  std::shared_ptr<grpc::ChannelCredentials> channel = grpc::SslCredentials(options);
  if (secrets.token.empty()) return channel;
  return grpc::CompositeChannelCredentials(
      channel,
      grpc::MetadataCredentialsFromPlugin(std::make_unique<TokenPlugin>(std::move(secrets.token))));
}

}  // namespace robostress
