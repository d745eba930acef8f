#pragma once

#include <vector>

#include "absl/types/span.h"
#include "common/types.h"
#include "nlohmann/json.hpp"

namespace robostress {

// A feature's statistics as LeRobot's meta/stats.json has them: min, max, mean, std, count, q01,
// q10, q50, q90, q99.

// Of rows of `width` numbers.
nlohmann::ordered_json VectorStatistics(absl::Span<const double> rows, size_t width);
// Of pictures, per channel, values scaled to 0..1; shapes [3, 1, 1].
nlohmann::ordered_json PictureStatistics(const std::vector<Image>& pictures);
// Of both together. Quantiles are averaged by count, as LeRobot does when it joins episodes.
nlohmann::ordered_json JoinStatistics(const nlohmann::ordered_json& a,
                                      const nlohmann::ordered_json& b);

}  // namespace robostress
