#include "common/statistics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>

#include "common/bootstrap_replicates.h"
#include "common/check.h"

namespace robostress {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

// Sum and count of one cluster within one stratum.
struct Part {
  int stratum = 0;
  double sum = 0;
  int count = 0;
};

// Mean over strata of weighted means; strata that drew nothing are left out.
class Accumulator {
 public:
  explicit Accumulator(int strata) : sums_(strata), counts_(strata) {}
  void Reset() {
    std::fill(sums_.begin(), sums_.end(), 0);
    std::fill(counts_.begin(), counts_.end(), 0);
  }
  void Add(const Part& part) {
    sums_[part.stratum] += part.sum;
    counts_[part.stratum] += part.count;
  }
  double Mean() const {
    double total = 0;
    int present = 0;
    for (size_t s = 0; s < sums_.size(); ++s) {
      if (counts_[s] == 0) continue;
      total += sums_[s] / counts_[s];
      ++present;
    }
    return present == 0 ? kNaN : total / present;
  }

 private:
  std::vector<double> sums_;
  std::vector<int64_t> counts_;
};

// Sums and counts of every cluster within every stratum, strata numbered from 0.
struct ClusterTable {
  std::vector<std::vector<Part>> clusters;
  int strata = 0;
};

ClusterTable TableOf(const std::vector<ClusteredValue>& values) {
  std::map<int, std::map<int, Part>> by_cluster;
  std::map<int, int> strata;
  for (const ClusteredValue& value : values) strata.emplace(value.stratum, 0);
  int next = 0;
  for (auto& [stratum, index] : strata) index = next++;
  for (const ClusteredValue& value : values) {
    Part& part = by_cluster[value.cluster][value.stratum];
    part.stratum = strata[value.stratum];
    part.sum += value.value;
    ++part.count;
  }
  ClusterTable table;
  table.strata = next;
  for (const auto& [cluster, parts] : by_cluster) {
    table.clusters.emplace_back();
    for (const auto& [stratum, part] : parts) table.clusters.back().push_back(part);
  }
  return table;
}

std::vector<double> Replicates(const ClusterTable& table, int replicates, const StreamKey& key) {
  const int count = static_cast<int>(table.clusters.size());
  if (count < 2 || replicates < 1) return {};
  Accumulator accumulator(table.strata);
  RandomStream stream(key);
  std::vector<double> means(replicates);
  for (double& mean : means) {
    accumulator.Reset();
    for (int draw = 0; draw < count; ++draw) {
      for (const Part& part : table.clusters[stream.UniformInt(count)]) accumulator.Add(part);
    }
    mean = accumulator.Mean();
  }
  return means;
}

}  // namespace

Interval WilsonInterval(int successes, int n) {
  if (n <= 0) return {kNaN, kNaN};
  constexpr double z = 1.959963984540054;
  const double p = static_cast<double>(successes) / n;
  const double scale = 1 / (1 + z * z / n);
  const double center = p + z * z / (2.0 * n);
  const double half = z * std::sqrt(p * (1 - p) / n + z * z / (4.0 * n * n));
  // The ends are exactly 0 and 1 at the extremes; rounding must not leave them.
  return {successes == 0 ? 0.0 : std::max(0.0, scale * (center - half)),
          successes == n ? 1.0 : std::min(1.0, scale * (center + half))};
}

double Quantile(const std::vector<double>& sorted, double q) {
  const double position = q * (sorted.size() - 1);
  const size_t below = static_cast<size_t>(position);
  const size_t above = std::min(below + 1, sorted.size() - 1);
  return sorted[below] + (position - below) * (sorted[above] - sorted[below]);
}

double UpperMedian(std::vector<double> values) {
  RS_CHECK(!values.empty());
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

std::vector<double> ClusterReplicates(const std::vector<ClusteredValue>& values, int replicates,
                                      const StreamKey& key) {
  return Replicates(TableOf(values), replicates, key);
}

BootstrapResult ClusterBootstrap(const std::vector<ClusteredValue>& values, int replicates,
                                 const StreamKey& key) {
  const ClusterTable table = TableOf(values);
  Accumulator accumulator(table.strata);
  for (const auto& cluster : table.clusters) {
    for (const Part& part : cluster) accumulator.Add(part);
  }
  BootstrapResult result;
  result.estimate = accumulator.Mean();
  result.clusters = static_cast<int>(table.clusters.size());
  result.interval = {kNaN, kNaN};
  std::vector<double> means = Replicates(table, replicates, key);
  if (means.empty()) return result;
  std::sort(means.begin(), means.end());
  result.interval = {Quantile(means, 0.025), Quantile(means, 0.975)};
  return result;
}

}  // namespace robostress
