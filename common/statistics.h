#pragma once

#include <vector>

#include "common/random.h"

namespace robostress {

// A confidence interval; NaN ends where the data cannot support one.
struct Interval {
  double low = 0, high = 0;
};

// Wilson score interval of a proportion k / n at confidence 1 - alpha = 0.95:
//   (p + z^2/2n -+ z sqrt(p(1-p)/n + z^2/4n^2)) / (1 + z^2/n),  z = 1.96   (Wilson 1927)
// Descriptive: it treats episodes as independent, which adapted ones are not.
Interval WilsonInterval(int successes, int n);

// One observation of a clustered, stratified sample: here the success of an episode (0/1), or the
// difference of two methods on the same episode; cluster = (suite, task, initial state), stratum =
// scenario.
struct ClusteredValue {
  int cluster = 0;
  int stratum = 0;
  double value = 0;
};

// Estimate: the mean over strata of the mean within each.
struct BootstrapResult {
  double estimate = 0;
  Interval interval;
  int clusters = 0;
};

// Percentile bootstrap over clusters (Efron & Tibshirani, ch. 13; clusters resampled with
// replacement, all their observations with them): each replicate draws as many clusters as there
// are. One cluster gives NaN ends. The result depends on the values and on `key` only.
BootstrapResult ClusterBootstrap(const std::vector<ClusteredValue>& values, int replicates,
                                 const StreamKey& key);

// Quantile by linear interpolation between order statistics (type 7); `sorted` ascending, not
// empty, q in [0, 1].
double Quantile(const std::vector<double>& sorted, double q);

// The middle value, of an even number the upper of the two; not empty.
double UpperMedian(std::vector<double> values);

}  // namespace robostress
