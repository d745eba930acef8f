#pragma once

#include <vector>

namespace robostress::calibration {

// Dynamic time warping of two series (Sakoe & Chiba 1978, symmetric steps without weights or
// window): the path from (0, 0) to (n - 1, m - 1) in steps (1, 0), (0, 1), (1, 1) with the least
// sum of |a_i - b_j|.
struct Dtw {
  double total = 0;     // that sum, in the unit of the series
  double per_step = 0;  // total over the cells of the path; of equal sums the shortest path counts
  int path_length = 0;
};

// Neither series may be empty. O(n m) time, O(m) memory.
Dtw DtwDistance(const std::vector<double>& a, const std::vector<double>& b);

}  // namespace robostress::calibration
