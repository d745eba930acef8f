#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/time/time.h"
#include "server/wire/grpc/policy_service.h"
#include "server/wire/openpi/openpi_conversation.h"
#include "server/wire/web/web_server.h"

namespace robostress {

struct WebEndpointsOptions {
  std::string websocket_listen, http_listen;  // empty: not served
  std::shared_ptr<TlsStore> tls;              // null: plain
  int max_connections = 256;
  int websocket_workers = 96;  // messages answered at a time, WebServerOptions::workers
  int max_connections_per_client = 0;
  std::vector<std::string> allowed_hosts;
  uint64_t max_message_bytes = 0;  // of a WebSocket; 0: what the policies need
  // WebServerOptions
  absl::Duration request_timeout = absl::Seconds(30), idle_timeout = absl::Seconds(60);
  OpenpiOptions openpi;
};

// The openpi endpoint and the operators' pages of a policy server, each on a port of its own.
class WebEndpoints {
 public:
  // `server` must outlive it.
  static absl::StatusOr<std::unique_ptr<WebEndpoints>> Start(const WebEndpointsOptions& options,
                                                             PolicyServer* server);

  int websocket_port() const { return websocket_ == nullptr ? 0 : websocket_->port(); }
  int http_port() const { return http_ == nullptr ? 0 : http_->port(); }
  // Openpi's clients get the answers under way within `grace`; the pages stay until the end.
  void StopWebSockets(absl::Duration grace);

 private:
  WebEndpoints() = default;
  std::unique_ptr<WebServer> http_, websocket_;
};

}  // namespace robostress
