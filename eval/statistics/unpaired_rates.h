#pragma once

#include <vector>

#include "common/statistics.h"

// Success rates of samples that share no episode, such as those of two laboratories. Episodes of
// one initial state are a cluster; a rate of clustered outcomes counts as one of fewer independent
// ones (Rao & Scott 1992, "A simple method for the analysis of clustered binary data").
namespace robostress {

// A success rate and what its episodes are worth.
struct ClusteredRate {
  int n = 0, successes = 0;
  int clusters = 0;          // initial states
  double design_effect = 1;  // variance of the rate over that of n independent episodes, 1 or more

  double rate() const { return n == 0 ? 0 : static_cast<double>(successes) / n; }
  double effective_n() const { return n / design_effect; }
};

// Of outcomes 0 and 1; strata are not told apart. The design effect is Kish's with the factor
// m / (m - 1) of m clusters; where every outcome is the same it cannot be measured and is the mean
// number of episodes of a cluster, as if repeats added nothing.
ClusteredRate RateOf(const std::vector<ClusteredValue>& outcomes);

// Wilson's interval of n / design_effect episodes; Wilson's own where the effect is 1. NaN ends
// without an episode.
Interval RateInterval(const ClusteredRate& rate);

struct RateDifference {
  double estimate = 0;  // second - first
  Interval interval;
  double p_value = 1;
};

// Two independent samples. Interval: Newcombe's method 10 (Newcombe 1998), which puts the intervals
// of the two rates together; with RateInterval of clustered ones it is Zou & Donner's (2008). p
// value: the two-sided score test of equal rates, pooled, on effective numbers. NaN where a sample
// is empty. Where both samples began at the same initial states they share what makes a state hard:
// then the interval is too wide and p too large, never the other way.
RateDifference CompareRates(const ClusteredRate& first, const ClusteredRate& second);

// The interval of second - first from an interval of each, of any kind: the square root of the sum
// of squares of the distances to the ends (Zou & Donner 2008).
Interval DifferenceInterval(double first, const Interval& of_first, double second,
                            const Interval& of_second);

}  // namespace robostress
