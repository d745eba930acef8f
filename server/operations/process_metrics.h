#pragma once

#include <string>

#include "server/operations/metrics.h"

namespace robostress {

// What Prometheus's clients say of every process (process_*, from /proc and getrlimit), and
// robostress_build_info. Values are read when the figures are.
void AddProcessMetrics(Metrics* metrics);

// Free and total bytes of the file system that holds `folder`. Nothing is shown while it cannot be
// asked.
void AddDiskMetrics(const std::string& folder, Metrics* metrics);

}  // namespace robostress
