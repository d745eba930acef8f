#include "eval/statistics/paired_tests.h"

#include <algorithm>
#include <boost/math/distributions/binomial.hpp>
#include <boost/math/distributions/normal.hpp>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <numeric>

namespace robostress {
namespace {

constexpr double kMostAdditions = 3e7;
constexpr int64_t kLargestMultiple = 1'000'000;

// Sum and count of one cluster within one stratum.
struct Part {
  double sum = 0;
  int count = 0;
};
using Parts = std::map<int, std::map<int, Part>>;  // cluster -> stratum

Parts PartsOf(const std::vector<ClusteredValue>& values) {
  Parts parts;
  for (const ClusteredValue& value : values) {
    Part& part = parts[value.cluster][value.stratum];
    part.sum += value.value;
    ++part.count;
  }
  return parts;
}

std::map<int, int> CountsOf(const std::vector<ClusteredValue>& values) {
  std::map<int, int> counts;  // by stratum
  for (const ClusteredValue& value : values) ++counts[value.stratum];
  return counts;
}

// What each cluster adds to strata x mean, in whole multiples of 1 / (a common multiple of the
// strata's sizes), by their greatest common divisor; empty when it is no whole number or grows too
// large.
std::vector<int64_t> WholeContributions(const Parts& parts, const std::map<int, int>& counts) {
  int64_t multiple = 1;
  for (const auto& [stratum, count] : counts) {
    multiple = std::lcm(multiple, static_cast<int64_t>(count));
    if (multiple > kLargestMultiple) return {};
  }
  std::vector<int64_t> contributions;
  int64_t divisor = 0;
  for (const auto& [cluster, strata] : parts) {
    int64_t total = 0;
    for (const auto& [stratum, part] : strata) {
      if (part.sum != std::round(part.sum)) return {};
      total += static_cast<int64_t>(part.sum) * (multiple / counts.at(stratum));
    }
    contributions.push_back(std::abs(total));
    divisor = std::gcd(divisor, contributions.back());
  }
  for (int64_t& contribution : contributions) contribution /= std::max<int64_t>(divisor, 1);
  return contributions;
}

// P(|sum of +-c| >= |observed|) by convolution.
double EnumeratedTail(const std::vector<int64_t>& contributions, int64_t observed) {
  const int64_t reach = std::accumulate(contributions.begin(), contributions.end(), int64_t{0});
  std::vector<double> probability(2 * reach + 1, 0.0), next(2 * reach + 1);
  probability[reach] = 1;
  int64_t extent = 0;  // of what is not zero
  for (const int64_t c : contributions) {
    if (c == 0) continue;
    std::fill(next.begin() + (reach - extent - c), next.begin() + (reach + extent + c + 1), 0.0);
    for (int64_t at = reach - extent; at <= reach + extent; ++at) {
      next[at - c] += 0.5 * probability[at];
      next[at + c] += 0.5 * probability[at];
    }
    extent += c;
    std::swap(probability, next);
  }
  double tail = 0;
  for (int64_t at = 0; at <= 2 * reach; ++at) {
    if (std::abs(at - reach) >= observed) tail += probability[at];
  }
  return std::min(1.0, tail);
}

double DrawnTail(const std::vector<double>& contributions, const StreamKey& key) {
  const double observed =
      std::abs(std::accumulate(contributions.begin(), contributions.end(), 0.0));
  RandomStream stream(key);
  int hits = 0;
  for (int draw = 0; draw < kSignFlipDraws; ++draw) {
    double sum = 0;
    uint32_t bits = 0;
    for (size_t i = 0; i < contributions.size(); ++i) {
      if (i % 32 == 0) bits = stream.NextUint32();
      sum += (bits & 1) != 0 ? contributions[i] : -contributions[i];
      bits >>= 1;
    }
    // Rounding must not make the observed arrangement miss itself.
    hits += std::abs(sum) >= observed * (1 - 1e-12);
  }
  return (1.0 + hits) / (1.0 + kSignFlipDraws);
}

}  // namespace

double ExactMcNemar(int plus, int minus) {
  const boost::math::binomial wins(plus + minus, 0.5);
  return std::min(1.0, 2 * boost::math::cdf(wins, std::min(plus, minus)));
}

SignFlipResult ClusterSignFlipTest(const std::vector<ClusteredValue>& differences,
                                   const StreamKey& key) {
  const Parts parts = PartsOf(differences);
  const std::map<int, int> counts = CountsOf(differences);
  std::vector<double> contributions;
  for (const auto& [cluster, strata] : parts) {
    contributions.push_back(0);
    for (const auto& [stratum, part] : strata)
      contributions.back() += part.sum / counts.at(stratum);
  }
  const double observed = std::accumulate(contributions.begin(), contributions.end(), 0.0);
  const double size = std::accumulate(contributions.begin(), contributions.end(), 0.0,
                                      [](double sum, double c) { return sum + std::abs(c); });
  if (size == 0) return {1, true};
  const std::vector<int64_t> whole = WholeContributions(parts, counts);
  const int64_t reach = std::accumulate(whole.begin(), whole.end(), int64_t{0});
  if (!whole.empty() && static_cast<double>(reach) * whole.size() * 2 < kMostAdditions) {
    // One unit of `whole` is size / reach of the contributions.
    const auto units = static_cast<int64_t>(std::llround(std::abs(observed) * reach / size));
    return {EnumeratedTail(whole, units), true};
  }
  return {DrawnTail(contributions, key), false};
}

std::vector<double> HolmAdjust(const std::vector<double>& p_values) {
  std::vector<size_t> order;
  for (size_t i = 0; i < p_values.size(); ++i) {
    if (!std::isnan(p_values[i])) order.push_back(i);
  }
  std::stable_sort(order.begin(), order.end(),
                   [&](size_t a, size_t b) { return p_values[a] < p_values[b]; });
  std::vector<double> adjusted = p_values;
  double largest = 0;
  for (size_t rank = 0; rank < order.size(); ++rank) {
    largest = std::max(largest, std::min(1.0, (order.size() - rank) * p_values[order[rank]]));
    adjusted[order[rank]] = largest;
  }
  return adjusted;
}

double DesignEffect(const std::vector<ClusteredValue>& differences) {
  const std::map<int, int> counts = CountsOf(differences);
  std::map<int, double> means, single, clustered;  // by stratum
  for (const ClusteredValue& d : differences) means[d.stratum] += d.value / counts.at(d.stratum);
  for (const ClusteredValue& d : differences)
    single[d.stratum] += (d.value - means[d.stratum]) * (d.value - means[d.stratum]);
  const Parts parts = PartsOf(differences);
  if (parts.size() < 2) return 1;
  for (const auto& [cluster, strata] : parts) {
    for (const auto& [stratum, part] : strata) {
      const double deviation = part.sum - part.count * means[stratum];
      clustered[stratum] += deviation * deviation;
    }
  }
  double sum = 0;
  int strata = 0;
  for (const auto& [stratum, variance] : single) {
    if (variance <= 0) continue;
    sum += clustered[stratum] / variance;
    ++strata;
  }
  return strata == 0 ? 1 : sum / strata;
}

std::optional<double> PairsNeeded(double difference, double discordant_share, double alpha,
                                  double power) {
  const double d = std::abs(difference), psi = discordant_share;
  if (!(d > 0 && d <= psi && psi <= 1 && alpha > 0 && alpha < 1 && power > 0 && power < 1))
    return std::nullopt;
  const boost::math::normal normal;
  const double z = boost::math::quantile(boost::math::complement(normal, alpha / 2));
  const double root =
      z * std::sqrt(psi) + boost::math::quantile(normal, power) * std::sqrt(psi - d * d);
  return root * root / (d * d);
}

}  // namespace robostress
