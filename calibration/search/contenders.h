#pragma once

#include <algorithm>
#include <cmath>
#include <vector>

#include "calibration/search/surrogates.h"

namespace robostress::calibration {

// A candidate on top of a base, after screening.
struct Contender {
  int candidate = 0;                     // of the screening
  std::vector<const Signature*> starts;  // best first
  double gain = 0, p = 1, own_p = 1, surviving = 0;
  // What is left of `error` if the gain holds.
  double Promised(double error) const { return error * std::sqrt(std::max(0.0, 1 - gain)); }
};

// The screening's candidates, best first.
std::vector<Contender> Rank(const Screening& screening, const NullDistribution& null);

// Moves to the front what is worth a refit, and returns how many: `at_most` candidates that beat
// their own chance, of what could matter beside the best, `share` of its gain; and dry friction
// that beats the library's, because a small friction, of which a signature is made, lets a joint
// creep that a large one holds.
int ChooseFinalists(std::vector<Contender>& contenders, const std::vector<Candidate>& candidates,
                    int at_most, double share = 0.25);

}  // namespace robostress::calibration
