#pragma once

#include <array>
#include <cstdint>
#include <string>

namespace robostress {

// Lateness of control ticks. Counted by the control thread, read when it has stopped.
struct TickTiming {
  // Upper edges of the histogram [us]; the last bin is open.
  static constexpr std::array<int64_t, 15> kEdges_us = {
      5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10000, 20000, 33333, 50000, 100000};
  std::array<uint64_t, kEdges_us.size() + 1> wake{};  // from the deadline to the start of the tick
  std::array<uint64_t, kEdges_us.size() + 1>
      sent{};  // from the deadline to the command's hand-over
  uint64_t ticks = 0;
  uint64_t missed = 0;   // ticks that were not done by the next deadline
  uint64_t skipped = 0;  // deadlines that passed meanwhile: no tick ran for them
  int64_t worst_wake_ns = 0, worst_sent_ns = 0;

  void Add(int64_t wake_ns, int64_t sent_ns);
  // Least edge [us] below which the share `p` of `bins` lies; 0 without ticks, INT64_MAX beyond the
  // last edge.
  static int64_t QuantileEdge_us(const std::array<uint64_t, kEdges_us.size() + 1>& bins, double p);
  std::string Json() const;
};

}  // namespace robostress
