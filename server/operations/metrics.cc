#include "server/operations/metrics.h"

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <variant>

#include "common/check.h"

namespace robostress {

double QuantileOf(const Histogram& histogram, double q) {
  const prometheus::ClientMetric::Histogram now = histogram.Collect().histogram;
  if (now.sample_count == 0) return 0;
  const double rank = q * static_cast<double>(now.sample_count);
  double low = 0, below = 0;
  for (const prometheus::ClientMetric::Bucket& bucket : now.bucket) {
    if (std::isinf(bucket.upper_bound)) break;
    const auto up_to = static_cast<double>(bucket.cumulative_count);
    if (up_to > below && up_to >= rank)
      return low +
             (bucket.upper_bound - low) * std::clamp((rank - below) / (up_to - below), 0., 1.);
    low = bucket.upper_bound;
    below = up_to;
  }
  return low;
}

std::vector<double> LatencyBounds() {
  return {5e-5,  1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 0.01, 0.02, 0.03, 0.05,
          0.075, 0.1,  0.15, 0.2,  0.3,  0.5,  1,    2,    5,    10,   30};
}
std::vector<double> CountBounds() { return {0, 1, 2, 4, 8, 16, 32, 64}; }
std::vector<double> ResidualBounds() {
  return {0.001, 0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 4};
}

struct Metrics::Family {
  using Series =
      std::variant<std::shared_ptr<Counter>, std::shared_ptr<Gauge>, std::shared_ptr<Histogram>>;
  std::string name, help;
  prometheus::MetricType type;
  std::map<MetricLabels, Series> series;
};

Metrics::Metrics() = default;
Metrics::~Metrics() = default;

template <class T>
std::shared_ptr<T> Metrics::Add(const std::string& name, const std::string& help,
                                const MetricLabels& labels,
                                const std::function<std::shared_ptr<T>()>& make) {
  absl::MutexLock lock(&mu_);
  auto at = std::lower_bound(
      families_.begin(), families_.end(), name,
      [](const std::unique_ptr<Family>& family, const std::string& n) { return family->name < n; });
  if (at == families_.end() || (*at)->name != name) {
    at = families_.insert(at, std::make_unique<Family>(Family{name, help, T::metric_type, {}}));
  }
  RS_CHECK((*at)->type == T::metric_type);  // one name, two kinds
  auto& series = (*at)->series;
  const auto found = series.find(labels);
  if (found != series.end()) return std::get<std::shared_ptr<T>>(found->second);
  std::shared_ptr<T> made = make();
  series.emplace(labels, made);
  return made;
}

std::shared_ptr<Counter> Metrics::AddCounter(const std::string& name, const std::string& help,
                                             const MetricLabels& labels) {
  return Add<Counter>(name, help, labels, [] { return std::make_shared<Counter>(); });
}

std::shared_ptr<Gauge> Metrics::AddGauge(const std::string& name, const std::string& help,
                                         const MetricLabels& labels) {
  return Add<Gauge>(name, help, labels, [] { return std::make_shared<Gauge>(); });
}

std::shared_ptr<Histogram> Metrics::AddHistogram(const std::string& name, const std::string& help,
                                                 const std::vector<double>& bounds,
                                                 const MetricLabels& labels) {
  return Add<Histogram>(name, help, labels,
                        [&bounds] { return std::make_shared<Histogram>(bounds); });
}

void Metrics::AddCollector(std::function<void()> collect) {
  absl::MutexLock lock(&mu_);
  collectors_.push_back(std::move(collect));
}

void Metrics::Remove(const std::string& label, const std::string& value) {
  absl::MutexLock lock(&mu_);
  for (const auto& family : families_) {
    std::erase_if(family->series, [&](const auto& series) {
      return std::find(series.first.begin(), series.first.end(), std::pair(label, value)) !=
             series.first.end();
    });
  }
}

size_t Metrics::size() const {
  absl::MutexLock lock(&mu_);
  size_t size = 0;
  for (const auto& family : families_) size += family->series.size();
  return size;
}

std::string Metrics::Text() const {
  std::vector<std::function<void()>> collectors;
  {
    absl::MutexLock lock(&mu_);
    collectors = collectors_;
  }
  {
    absl::MutexLock lock(&collecting_);
    for (const auto& collect : collectors) collect();
  }
  std::vector<prometheus::MetricFamily> families;
  absl::MutexLock lock(&mu_);
  for (const auto& family : families_) {
    if (family->series.empty()) continue;
    prometheus::MetricFamily& shown = families.emplace_back();
    shown.name = family->name;
    shown.help = family->help;
    shown.type = family->type;
    for (const auto& [labels, series] : family->series) {
      shown.metric.push_back(std::visit([](const auto& one) { return one->Collect(); }, series));
      for (const auto& [label, value] : labels) shown.metric.back().label.push_back({label, value});
    }
  }
  return prometheus::TextSerializer().Serialize(families);
}

}  // namespace robostress
