#include "robot_client/piper/age_statistics.h"

#include <algorithm>

namespace robostress::piper {

void AgeStatistics::Add(int64_t stamp_ns, int64_t arrival_ns) {
  Until(arrival_ns);
  any_ = true;
  stamp_ns_ = stamp_ns;
  counted_ns_ = std::max(arrival_ns, counted_ns_);
}

void AgeStatistics::Until(int64_t now_ns) {
  if (!any_ || now_ns <= counted_ns_) return;
  Count(counted_ns_ - stamp_ns_, now_ns - stamp_ns_);
  counted_ns_ = now_ns;
}

void AgeStatistics::Count(int64_t from_age_ns, int64_t to_age_ns) {
  const double from_s = 1e-9 * static_cast<double>(from_age_ns);
  const double to_s = 1e-9 * static_cast<double>(to_age_ns);
  integral_s2_ += (to_s * to_s - from_s * from_s) / 2;
  time_s_ += to_s - from_s;
  worst_ns_ = std::max(worst_ns_, to_age_ns);
  while (from_age_ns < to_age_ns) {
    const int64_t bin = std::clamp<int64_t>(from_age_ns / kBin_ns, 0, kBins);
    const int64_t end_ns = bin == kBins ? to_age_ns : std::min(to_age_ns, (bin + 1) * kBin_ns);
    bins_s_[bin] += 1e-9 * static_cast<double>(end_ns - from_age_ns);
    from_age_ns = end_ns;
  }
}

AgeStatistics::Summary AgeStatistics::summary() const {
  if (time_s_ <= 0) return {};
  Summary summary{integral_s2_ / time_s_, 0, 1e-9 * static_cast<double>(worst_ns_)};
  summary.p99_s = summary.worst_s;
  double below_s = 0;
  for (int64_t bin = 0; bin < kBins; ++bin) {
    below_s += bins_s_[bin];
    if (below_s < 0.99 * time_s_) continue;
    summary.p99_s = std::min(summary.worst_s, 1e-9 * static_cast<double>((bin + 1) * kBin_ns));
    break;
  }
  return summary;
}

void AgeStatistics::Reset() {
  worst_ns_ = 0;
  integral_s2_ = time_s_ = 0;
  bins_s_.fill(0);
}

}  // namespace robostress::piper
