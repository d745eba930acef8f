#pragma once

#include <prometheus/counter.h>
#include <prometheus/gauge.h>
#include <prometheus/histogram.h>

#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "absl/base/thread_annotations.h"
#include "absl/synchronization/mutex.h"

namespace robostress {

// prometheus-cpp's own. Any thread. Counter and Gauge are atomics; Histogram::Observe takes a mutex
// of its own, and wants a finite value.
using prometheus::Counter;
using prometheus::Gauge;
using prometheus::Histogram;

// Linear within the bucket; the last bound where it lies beyond; 0 before the first value.
double QuantileOf(const Histogram& histogram, double q);

// [s], 50 us .. 30 s.
std::vector<double> LatencyBounds();
// 1, 2, 4 .. 64: rows of a batch, entries of a queue.
std::vector<double> CountBounds();
// Of a residual in units of a normalised action: 0.001 .. 4.
std::vector<double> ResidualBounds();

using MetricLabels = std::vector<std::pair<std::string, std::string>>;

// All that a server counts, as Prometheus reads it. The same name and labels give the same object;
// a name has one kind and one help text, programmer error otherwise. What is handed out stays
// usable after Remove, but is no longer shown. Any thread. Not prometheus::Registry: that frees a
// series under the thread that still counts in it, and shows series in no order.
//   metrics->AddCounter("robostress_predictions_total", "Predictions answered.")->Increment();
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
  // Runs before every Text, one at a time: sets gauges of what is only known by asking. It lives as
  // long as `this`.
  void AddCollector(std::function<void()> collect) ABSL_LOCKS_EXCLUDED(mu_);
  // Drops every series with this label, e.g. those of a session that was closed.
  void Remove(const std::string& label, const std::string& value) ABSL_LOCKS_EXCLUDED(mu_);
  // Number of series now.
  size_t size() const ABSL_LOCKS_EXCLUDED(mu_);
  // Prometheus' text exposition format, version 0.0.4.
  std::string Text() const ABSL_LOCKS_EXCLUDED(collecting_, mu_);

 private:
  struct Family;

  template <class T>
  std::shared_ptr<T> Add(const std::string& name, const std::string& help,
                         const MetricLabels& labels,
                         const std::function<std::shared_ptr<T>()>& make) ABSL_LOCKS_EXCLUDED(mu_);

  mutable absl::Mutex collecting_ ABSL_ACQUIRED_BEFORE(mu_);
  mutable absl::Mutex mu_;
  std::vector<std::unique_ptr<Family>> families_ ABSL_GUARDED_BY(mu_);  // in the order of names
  std::vector<std::function<void()>> collectors_ ABSL_GUARDED_BY(mu_);
};

}  // namespace robostress
