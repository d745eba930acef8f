#include "server/web_endpoints.h"

#include <chrono>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"
#include "server/operations/access_table.h"
#include "server/pages/operations_pages.h"
#include "server/wire/grpc/grpc_access.h"

namespace robostress {
namespace {

// A conversation that ends when its client's token is revoked or may do something else.
class RevocableConversation : public WebConversation {
 public:
  RevocableConversation(std::unique_ptr<WebConversation> conversation,
                        std::shared_ptr<const TokenStore> tokens, uint64_t generation,
                        const WebRequest& request, const Caller& caller)
      : conversation_(std::move(conversation)),
        tokens_(std::move(tokens)),
        authorization_(request.authorization),
        scopes_(caller.scopes),
        owner_(caller.owner),
        asked_(generation) {}

  std::string Greeting() override { return conversation_->Greeting(); }
  uint64_t LargestMessage() const override { return conversation_->LargestMessage(); }
  std::string client() const override { return conversation_->client(); }
  absl::StatusOr<std::string> Answer(std::string_view message) override {
    RS_RETURN_IF_ERROR(StillAllowed());
    return conversation_->Answer(message);
  }

 private:
  absl::Status StillAllowed() {
    const uint64_t generation = tokens_->generation();
    if (generation == asked_) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(const Caller now, tokens_->Get()->Authenticate(authorization_));
    if (now.scopes != scopes_ || now.owner != owner_)
      return absl::PermissionDeniedError("what your token may do has changed; connect again");
    asked_ = generation;
    return absl::OkStatus();
  }

  const std::unique_ptr<WebConversation> conversation_;
  const std::shared_ptr<const TokenStore> tokens_;
  const std::string authorization_;
  const uint8_t scopes_;
  const std::string owner_;
  uint64_t asked_;  // the tokens' generation when the client was let in or asked again
};

}  // namespace

absl::StatusOr<std::unique_ptr<WebEndpoints>> WebEndpoints::Start(
    const WebEndpointsOptions& options, PolicyServer* server) {
  auto endpoints = std::unique_ptr<WebEndpoints>(new WebEndpoints());
  WebServerOptions web;
  web.tls = options.tls;
  web.max_connections = options.max_connections;
  web.max_connections_per_client = options.max_connections_per_client;
  web.allowed_hosts = options.allowed_hosts;
  web.max_message_bytes = options.max_message_bytes;
  web.request_timeout = options.request_timeout;
  web.idle_timeout = options.idle_timeout;
  if (!options.websocket_listen.empty()) {
    web.name = "websocket";
    web.listen = options.websocket_listen;
    web.workers = options.websocket_workers;
    const auto upgrade =
        [server, openpi = options.openpi](
            const WebRequest& request) -> absl::StatusOr<std::unique_ptr<WebConversation>> {
      const std::shared_ptr<const TokenStore> tokens = server->tokens();
      const uint64_t generation = tokens->generation();
      RS_ASSIGN_OR_RETURN(Caller caller, Allow(*tokens->Get(), request.authorization,
                                               AccessRule::Wire::kWebSocket, "upgrade"));
      caller.host = HostOfPeer(request.peer);
      if (caller.owner.empty()) caller.owner = request.certificate_owner;
      if (!server->ready()) return absl::UnavailableError("warming up or draining");
      auto conversation =
          std::make_unique<OpenpiConversation>(openpi, &server->host(), &server->metrics(), caller);
      return std::make_unique<RevocableConversation>(std::move(conversation), tokens, generation,
                                                     request, caller);
    };
    const auto page = [](const WebRequest& request) -> WebReply {
      if (request.path == "/healthz") return {200, "text/plain; charset=utf-8", "OK\n"};
      return {426, "text/plain; charset=utf-8", "this port speaks openpi's WebSocket protocol\n"};
    };
    RS_ASSIGN_OR_RETURN(endpoints->websocket_,
                        WebServer::Start(web, page, upgrade, &server->metrics()));
  }
  if (!options.http_listen.empty()) {
    web.name = "http";
    web.listen = options.http_listen;
    web.workers = WebServerOptions().workers;
    OperationsSources sources;
    sources.metrics = &server->metrics();
    sources.traces = &server->traces();
    sources.telemetry = &server->telemetry();
    sources.tokens = server->tokens();
    sources.figures = [server] { return server->host().Figures(); };
    sources.ready = [server] { return server->ready(); };
    const auto begin = std::chrono::steady_clock::now();
    sources.server = [server, begin] {
      LiveServer live;
      std::vector<std::string> names;
      for (const PolicySpec& policy : server->host().policies())
        names.push_back(absl::StrCat(policy.name, " ", policy.model_hash.substr(0, 12)));
      live.policies = absl::StrJoin(names, ", ");
      const auto up = std::chrono::duration_cast<std::chrono::seconds>(
          std::chrono::steady_clock::now() - begin);
      live.uptime = absl::FormatDuration(absl::FromChrono(up));
      live.draining = server->sessions().draining();
      live.durable = server->sessions().durable();
      return live;
    };
    RS_ASSIGN_OR_RETURN(
        endpoints->http_,
        WebServer::Start(
            web, [sources](const WebRequest& request) { return OperationsPage(request, sources); },
            nullptr, &server->metrics()));
  }
  return endpoints;
}

void WebEndpoints::StopWebSockets(absl::Duration grace) {
  if (websocket_ != nullptr) websocket_->Stop(grace);
}

}  // namespace robostress
