#pragma once

#include <string>

#include "eval/statistics/summary.h"

namespace robostress {

// What the differences of the tables over all suites are worth: each method against base and
// against the controls with interval, p value and its correction for number; means over seeds with
// their spread; the episodes that a given difference needs. Empty when nothing was paired.
std::string StatisticsSection(const Summary& summary);

// Episodes that show a difference of `points` between two methods whose outcomes differ as those of
// `comparison` do, with the chance stated in PairsNeeded; design effects above 1 count. Empty where
// no number of episodes is enough: more points than outcomes differ.
std::string EpisodesNeededText(const Comparison& comparison, double points);

}  // namespace robostress
