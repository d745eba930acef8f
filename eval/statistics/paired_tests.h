#pragma once

#include <optional>
#include <string>
#include <vector>

#include "common/random.h"
#include "common/statistics.h"

// Tests of paired differences, their correction for number, and the pairs that a difference needs.
namespace robostress {

// Two-sided p value of the exact McNemar test: of `plus` + `minus` discordant pairs each is a win
// with probability 1/2 (McNemar 1947; binomial tail doubled, at most 1). It treats pairs as
// independent.
double ExactMcNemar(int plus, int minus);

struct SignFlipResult {
  double p_value = 1;
  bool exact = true;  // enumerated; otherwise estimated from kSignFlipDraws draws
};
inline constexpr int kSignFlipDraws = 20000;

// Two-sided randomisation test of "method and reference are exchangeable within every cluster": the
// signs of all differences of a cluster flip together, each way with probability 1/2; the statistic
// is that of ClusterBootstrap, the mean over strata of the means within. With one pair in each
// cluster and one stratum it is ExactMcNemar. Differences that are whole numbers (0/1 outcomes) are
// enumerated where that takes fewer than 3e7 additions; otherwise `key` seeds the draws, and p = (1
// + hits) / (1 + draws) (Phipson & Smyth 2010). Without a difference p is 1.
SignFlipResult ClusterSignFlipTest(const std::vector<ClusteredValue>& differences,
                                   const StreamKey& key);

// Holm's step-down adjusted p values (Holm 1979): the family-wise error is held under any
// dependence, which matters because comparisons share episodes. NaN stays NaN and is not counted.
std::vector<double> HolmAdjust(const std::vector<double>& p_values);

// Variance of the mean of `differences` with clusters kept together over that of single pairs
// (Kish's design effect), one stratum at a time, averaged over strata; 1 where nothing varies or
// there are fewer than two clusters.
double DesignEffect(const std::vector<ClusteredValue>& differences);

// Pairs that show a difference of success rates with probability `power` in a two-sided paired test
// at `alpha` (Connor 1987):
//   n = (z_{1 - alpha/2} sqrt(psi) + z_power sqrt(psi - d^2))^2 / d^2
// d: difference, psi: share of pairs whose outcomes differ, |d| <= psi <= 1. Multiply by the design
// effect for clustered pairs. nullopt where the numbers contradict each other.
std::optional<double> PairsNeeded(double difference, double discordant_share, double alpha = 0.05,
                                  double power = 0.8);

}  // namespace robostress
