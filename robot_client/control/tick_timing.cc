#include "robot_client/control/tick_timing.h"

#include <algorithm>
#include <limits>

#include "nlohmann/json.hpp"

namespace robostress {
namespace {

template <class Bins>
void Count(int64_t ns, Bins& bins) {
  const auto& edges = TickTiming::kEdges_us;
  const int64_t us = ns / 1000;
  ++bins[static_cast<size_t>(std::upper_bound(edges.begin(), edges.end(), us) - edges.begin())];
}

}  // namespace

void TickTiming::Add(int64_t wake_ns, int64_t sent_ns) {
  ++ticks;
  Count(wake_ns, wake);
  Count(sent_ns, sent);
  worst_wake_ns = std::max(worst_wake_ns, wake_ns);
  worst_sent_ns = std::max(worst_sent_ns, sent_ns);
}

int64_t TickTiming::QuantileEdge_us(const std::array<uint64_t, kEdges_us.size() + 1>& bins,
                                    double p) {
  uint64_t total = 0, below = 0;
  for (const uint64_t n : bins) total += n;
  if (total == 0) return 0;
  for (size_t i = 0; i < kEdges_us.size(); ++i) {
    below += bins[i];
    if (static_cast<double>(below) >= p * static_cast<double>(total)) return kEdges_us[i];
  }
  return std::numeric_limits<int64_t>::max();
}

std::string TickTiming::Json() const {
  const nlohmann::ordered_json json = {
      {"ticks", ticks},
      {"missed", missed},
      {"skipped", skipped},
      {"worst_wake_us", static_cast<double>(worst_wake_ns) / 1e3},
      {"worst_sent_us", static_cast<double>(worst_sent_ns) / 1e3},
      {"edges_us", kEdges_us},
      {"wake_histogram", wake},
      {"sent_histogram", sent},
  };
  return json.dump(2) + "\n";
}

}  // namespace robostress
