#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "server/operations/metrics.h"
#include "server/proxy/proxy_board.h"
#include "server/proxy/relay.h"
#include "server/wire/web/web_server.h"

namespace robostress {

// What the pages show. All outlive them.
struct ProxySources {
  ProxyBoard* board = nullptr;
  const Relay* relay = nullptr;
  Metrics* metrics = nullptr;
  std::string upstream;
};

// /: what was done, a page that loads itself again every two seconds; /state: the same as JSON;
// /metrics; /healthz; /readyz: whether the upstream is there.
WebReply ProxyPage(const WebRequest& request, const ProxySources& sources);

// {"mode": "on", "upstream_there": true, ...}
std::string ProxyStateJson(const ProxySources& sources);

// A WebSocket at /switch, for programs on this machine: a message "on", "off" or "state", the
// answer is ProxyStateJson after it. PERMISSION_DENIED for others; NOT_FOUND at another path.
absl::StatusOr<std::unique_ptr<WebConversation>> OpenProxySwitch(const WebRequest& request,
                                                                 const ProxySources& sources);

}  // namespace robostress
