#include "calibration/fidelity/dtw.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "common/check.h"

namespace robostress::calibration {

Dtw DtwDistance(const std::vector<double>& a, const std::vector<double>& b) {
  RS_CHECK(!a.empty() && !b.empty());
  // (sum, cells) of the best path to every cell of a row; pairs compare by sum, then by cells.
  using Cost = std::pair<double, int>;
  const Cost none{std::numeric_limits<double>::infinity(), 0};
  std::vector<Cost> before(b.size() + 1, none), row(b.size() + 1, none);
  before[0] = {0, 0};
  for (const double value : a) {
    row[0] = none;
    for (size_t j = 0; j < b.size(); ++j) {
      const Cost best = std::min({before[j], before[j + 1], row[j]});
      row[j + 1] = {best.first + std::abs(value - b[j]), best.second + 1};
    }
    std::swap(before, row);
  }
  const auto [total, cells] = before.back();
  return {total, total / cells, cells};
}

}  // namespace robostress::calibration
