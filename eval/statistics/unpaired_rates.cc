#include "eval/statistics/unpaired_rates.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

namespace robostress {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr double kZ = 1.959963984540054;  // of 95 %

}  // namespace

ClusteredRate RateOf(const std::vector<ClusteredValue>& outcomes) {
  struct Cluster {
    int n = 0, successes = 0;
  };
  std::map<int, Cluster> clusters;
  ClusteredRate rate;
  for (const ClusteredValue& outcome : outcomes) {
    Cluster& cluster = clusters[outcome.cluster];
    ++cluster.n;
    cluster.successes += outcome.value > 0.5;
    ++rate.n;
    rate.successes += outcome.value > 0.5;
  }
  rate.clusters = static_cast<int>(clusters.size());
  if (rate.clusters == 0 || rate.clusters == rate.n) return rate;
  const double p = rate.rate(), single = rate.n * p * (1 - p);
  int largest = 0;
  double together = 0;
  for (const auto& [name, cluster] : clusters) {
    const double deviation = cluster.successes - cluster.n * p;
    together += deviation * deviation;
    largest = std::max(largest, cluster.n);
  }
  const double m = rate.clusters;
  const double effect = single > 0 && m > 1 ? together / single * m / (m - 1) : rate.n / m;
  rate.design_effect = std::clamp(effect, 1.0, std::max(rate.n / m, static_cast<double>(largest)));
  return rate;
}

Interval RateInterval(const ClusteredRate& rate) {
  if (rate.n <= 0) return {kNaN, kNaN};
  if (rate.design_effect == 1) return WilsonInterval(rate.successes, rate.n);
  const double n = rate.effective_n(), p = rate.rate();
  const double scale = 1 / (1 + kZ * kZ / n), center = p + kZ * kZ / (2 * n);
  const double half = kZ * std::sqrt(p * (1 - p) / n + kZ * kZ / (4 * n * n));
  return {rate.successes == 0 ? 0.0 : std::max(0.0, scale * (center - half)),
          rate.successes == rate.n ? 1.0 : std::min(1.0, scale * (center + half))};
}

Interval DifferenceInterval(double first, const Interval& of_first, double second,
                            const Interval& of_second) {
  const double difference = second - first;
  return {difference - std::hypot(second - of_second.low, of_first.high - first),
          difference + std::hypot(of_second.high - second, first - of_first.low)};
}

RateDifference CompareRates(const ClusteredRate& first, const ClusteredRate& second) {
  RateDifference result;
  if (first.n <= 0 || second.n <= 0) return {kNaN, {kNaN, kNaN}, kNaN};
  result.estimate = second.rate() - first.rate();
  result.interval =
      DifferenceInterval(first.rate(), RateInterval(first), second.rate(), RateInterval(second));
  const double a = first.effective_n(), b = second.effective_n();
  const double pooled = (a * first.rate() + b * second.rate()) / (a + b);
  const double variance = pooled * (1 - pooled) * (1 / a + 1 / b);
  result.p_value =
      variance > 0 ? std::erfc(std::abs(result.estimate) / std::sqrt(2 * variance)) : 1;
  return result;
}

}  // namespace robostress
