#pragma once

#include <string>
#include <vector>

#include "server/operations/metrics.h"
#include "server/operations/telemetry.h"

namespace robostress {

// What stands above the sessions.
struct LiveServer {
  std::string policies;  // "nano (3f2a...)"
  std::string uptime;
  bool draining = false;
  bool durable = false;
};

// The page of a running server: its sessions with the residual over time, the adapter's drift,
// latencies and the last images. It needs nothing but what this server answers, reads without
// scripts, and where they run replaces its `<main>` every second.
std::string LivePage(const LiveServer& server, const std::vector<Telemetry::View>& sessions,
                     Metrics& metrics);
// The `<main>` element alone.
std::string LiveMain(const LiveServer& server, const std::vector<Telemetry::View>& sessions,
                     Metrics& metrics);
// The page's script.
std::string LiveScript();

}  // namespace robostress
