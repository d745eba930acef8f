#include "server/metrics.h"

#include <prometheus/metric_family.h>
#include <prometheus/text_serializer.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <variant>

#include "common/check.h"

namespace robostress {

Histogram::Histogram(std::vector<double> bounds)
    : bounds_(std::move(bounds)), counts_(bounds_.size() + 1) {}

void Histogram::Observe(double value) {
  if (!std::isfinite(value)) return;
  const auto at = std::lower_bound(bounds_.begin(), bounds_.end(), value);
  counts_[static_cast<size_t>(at - bounds_.begin())].fetch_add(1, std::memory_order_relaxed);
  sum_.fetch_add(value, std::memory_order_relaxed);
}

std::vector<uint64_t> Histogram::counts() const {
  std::vector<uint64_t> counts;
  for (const auto& count : counts_) counts.push_back(count.load(std::memory_order_relaxed));
  return counts;
}

double Histogram::Quantile(double q) const {
  const std::vector<uint64_t> counts = this->counts();
  uint64_t total = 0;
  for (const uint64_t count : counts) total += count;
  if (total == 0) return 0;
  const double rank = q * static_cast<double>(total);
  double below = 0;
  for (size_t i = 0; i < bounds_.size(); ++i) {
    const auto inside = static_cast<double>(counts[i]);
    if (inside > 0 && below + inside >= rank) {
      const double low = i == 0 ? 0 : bounds_[i - 1];
      return low + (bounds_[i] - low) * std::clamp((rank - below) / inside, 0.0, 1.0);
    }
    below += inside;
  }
  return bounds_.back();
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

namespace {

template <class T>
constexpr prometheus::MetricType kTypeOf = prometheus::MetricType::Untyped;
template <>
constexpr prometheus::MetricType kTypeOf<Counter> = prometheus::MetricType::Counter;
template <>
constexpr prometheus::MetricType kTypeOf<Gauge> = prometheus::MetricType::Gauge;
template <>
constexpr prometheus::MetricType kTypeOf<Histogram> = prometheus::MetricType::Histogram;

prometheus::ClientMetric::Histogram ToPrometheus(const Histogram& histogram) {
  prometheus::ClientMetric::Histogram result;
  uint64_t cumulative = 0;
  const std::vector<uint64_t> counts = histogram.counts();
  for (size_t i = 0; i < counts.size(); ++i) {
    cumulative += counts[i];
    result.bucket.push_back({cumulative, i < histogram.bounds().size()
                                             ? histogram.bounds()[i]
                                             : std::numeric_limits<double>::infinity()});
  }
  result.sample_count = cumulative;
  result.sample_sum = histogram.sum();
  return result;
}

}  // namespace

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
    at = families_.insert(at, std::make_unique<Family>(Family{name, help, kTypeOf<T>, {}}));
  }
  RS_CHECK((*at)->type == kTypeOf<T>);  // one name, two kinds
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
  for (const auto& collect : collectors) collect();
  std::vector<prometheus::MetricFamily> families;
  absl::MutexLock lock(&mu_);
  for (const auto& family : families_) {
    if (family->series.empty()) continue;
    prometheus::MetricFamily& shown = families.emplace_back();
    shown.name = family->name;
    shown.help = family->help;
    shown.type = family->type;
    for (const auto& [labels, series] : family->series) {
      prometheus::ClientMetric& metric = shown.metric.emplace_back();
      for (const auto& [name, value] : labels) metric.label.push_back({name, value});
      if (const auto* counter = std::get_if<std::shared_ptr<Counter>>(&series))
        metric.counter.value = (*counter)->value();
      if (const auto* gauge = std::get_if<std::shared_ptr<Gauge>>(&series))
        metric.gauge.value = (*gauge)->value();
      if (const auto* histogram = std::get_if<std::shared_ptr<Histogram>>(&series))
        metric.histogram = ToPrometheus(**histogram);
    }
  }
  return prometheus::TextSerializer().Serialize(families);
}

}  // namespace robostress
