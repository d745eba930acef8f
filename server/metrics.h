#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"

namespace robostress {

// A total that only grows. Any thread.
class Counter {
 public:
  void Add(double amount = 1) { value_.fetch_add(amount, std::memory_order_relaxed); }
  // For a total that somebody else counts: never falls, and two threads count nothing twice.
  void RaiseTo(double total) {
    double seen = value();
    while (seen < total && !value_.compare_exchange_weak(seen, total, std::memory_order_relaxed)) {
    }
  }
  double value() const { return value_.load(std::memory_order_relaxed); }

 private:
  std::atomic<double> value_{0};
};

// A value of now. Any thread.
class Gauge {
 public:
  void Set(double value) { value_.store(value, std::memory_order_relaxed); }
  void Add(double amount) { value_.fetch_add(amount, std::memory_order_relaxed); }
  double value() const { return value_.load(std::memory_order_relaxed); }

 private:
  std::atomic<double> value_{0};
};

// How often a value fell into (bounds[i-1], bounds[i]]; the last bucket has no upper bound. A value
// that is not finite counts nowhere. Any thread.
class Histogram {
 public:
  explicit Histogram(std::vector<double> bounds);  // rising
  void Observe(double value);
  const std::vector<double>& bounds() const { return bounds_; }
  std::vector<uint64_t> counts() const;  // [bounds + 1], not cumulative
  double sum() const { return sum_.load(std::memory_order_relaxed); }
  // Linear within the bucket; the last bound where it lies beyond; 0 before the first value.
  double Quantile(double q) const;

 private:
  const std::vector<double> bounds_;
  std::vector<std::atomic<uint64_t>> counts_;
  std::atomic<double> sum_{0};
};

// [s], 50 us .. 30 s.
std::vector<double> LatencyBounds();
// 1, 2, 4 .. 64: rows of a batch, entries of a queue.
std::vector<double> CountBounds();
// Of a residual in units of a normalised action: 0.001 .. 4.
std::vector<double> ResidualBounds();

using MetricLabels = std::vector<std::pair<std::string, std::string>>;

// All that a server counts, as Prometheus reads it. The same name and labels give the same object;
// a name has one kind and one help text, programmer error otherwise. What is handed out stays
// usable after Remove, but is no longer shown. Any thread.
//   metrics->AddCounter("robostress_predictions_total", "Predictions answered.")->Add();
class Metrics {
 public:
  Metrics();
  ~Metrics();
  std::shared_ptr<Counter> AddCounter(const std::string& name, const std::string& help,
                                      const MetricLabels& labels = {}) ABSL_LOCKS_EXCLUDED(mu_);
  std::shared_ptr<Gauge> AddGauge(const std::string& name, const std::string& help,
                                  const MetricLabels& labels = {}) ABSL_LOCKS_EXCLUDED(mu_);
  std::shared_ptr<Histogram> AddHistogram(const std::string& name, const std::string& help,
                                          const std::vector<double>& bounds,
                                          const MetricLabels& labels = {}) ABSL_LOCKS_EXCLUDED(mu_);
  // Runs before every Text: sets gauges of what is only known by asking. It lives as long as
  // `this`.
  void AddCollector(std::function<void()> collect) ABSL_LOCKS_EXCLUDED(mu_);
  // Drops every series with this label, e.g. those of a session that was closed.
  void Remove(const std::string& label, const std::string& value) ABSL_LOCKS_EXCLUDED(mu_);
  // Number of series now.
  size_t size() const ABSL_LOCKS_EXCLUDED(mu_);
  // Prometheus' text exposition format, version 0.0.4.
  std::string Text() const ABSL_LOCKS_EXCLUDED(mu_);

 private:
  struct Family;

  template <class T>
  std::shared_ptr<T> Add(const std::string& name, const std::string& help,
                         const MetricLabels& labels,
                         const std::function<std::shared_ptr<T>()>& make) ABSL_LOCKS_EXCLUDED(mu_);

  mutable absl::Mutex mu_;
  std::vector<std::unique_ptr<Family>> families_ ABSL_GUARDED_BY(mu_);  // in the order of names
  std::vector<std::function<void()>> collectors_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
