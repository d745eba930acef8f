#pragma once

#include <functional>
#include <vector>

#include "server/operations/access_tokens.h"
#include "server/operations/span_trace.h"
#include "server/operations/telemetry.h"
#include "server/pages/live_page.h"
#include "server/wire/web/web_server.h"

namespace robostress {

// What the pages for operators show. Everything must outlive them.
struct OperationsSources {
  Metrics* metrics = nullptr;
  TraceLog* traces = nullptr;
  Telemetry* telemetry = nullptr;
  std::shared_ptr<const TokenStore> tokens;
  std::function<std::vector<SessionFigures>()> figures;  // asked before sessions are shown
  std::function<LiveServer()> server;
  std::function<bool()> ready;  // warmed up and not draining
};

// What a probe asks, and nothing else: /healthz and /readyz, for everybody.
WebReply HealthPage(const WebRequest& request, const std::function<bool()>& ready);

// The answer to one request: /healthz (200 while the process answers), /readyz (200 or 503), / (the
// live page), /main, /image?session=S&camera=C (PNG), /metrics (Prometheus), /traces (trace event
// JSON of the last predictions). Who may read what stands in access_table.
WebReply OperationsPage(const WebRequest& request, const OperationsSources& sources);

}  // namespace robostress
