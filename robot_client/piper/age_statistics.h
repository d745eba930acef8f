#pragma once

#include <array>
#include <cstdint>

namespace robostress::piper {

// How old the newest sample of a stream is at a moment that is picked at random: between two
// arrivals the age grows from what the first sample had on arrival to what it has when the second
// comes. Follows from arrival stamps alone, so that a late reader changes nothing. For samples
// without delay every T seconds: mean T / 2, 99 % 0.99 T, worst T.
class AgeStatistics {
 public:
  struct Summary {
    double mean_s = 0, p99_s = 0, worst_s = 0;  // all 0: no time has passed since a first sample
  };

  // A sample that was measured at `stamp_ns` was complete at `arrival_ns`, not before the last one.
  void Add(int64_t stamp_ns, int64_t arrival_ns);
  // Until `now_ns`, when nothing newer has come.
  void Until(int64_t now_ns);
  Summary summary() const;
  // Begins anew at what was counted last; the newest sample stays known.
  void Reset();
  int64_t newest_stamp_ns() const { return stamp_ns_; }

 private:
  static constexpr int64_t kBin_ns = 100'000;
  static constexpr int64_t kBins = 3000;  // to 0.3 s; above, a percentile is the worst
  void Count(int64_t from_age_ns, int64_t to_age_ns);

  bool any_ = false;
  int64_t stamp_ns_ = 0, counted_ns_ = 0, worst_ns_ = 0;
  double integral_s2_ = 0, time_s_ = 0;     // of the age over time
  std::array<double, kBins + 1> bins_s_{};  // time spent at each age
};

}  // namespace robostress::piper
