#pragma once

#include <optional>
#include <vector>

#include "eval/statistics/comparison.h"

namespace robostress {

// What execution and adaptation did; absent where no episode has the measure.
struct Measures {
  std::optional<double> residual_mean;  // mean over rollouts of ||eta|| / ||a||: the paper's table
  std::optional<double> residual_pooled;  // sqrt(sum ||eta||^2 / sum ||a||^2)
  std::optional<double> tracking_mean;    // as residual_mean, residual_scale tracking
  std::optional<double> intent_mean;      // mean of ||dx - a_base|| / ||a_base||
  std::optional<double> intent_pooled;
  std::optional<double> mean_abs_action, clipped_share;
  std::optional<double> adapter_distance;  // ||phi - phi_0|| at the end, mean over units
};

Measures MeasuresOf(const Units& units);
// Means over cells, field by field.
Measures MeanMeasures(const std::vector<Measures>& all);

// Running mean of a measure that some episodes lack.
class Mean {
 public:
  void Add(const std::optional<double>& value) {
    if (!value) return;
    sum_ += *value;
    ++count_;
  }
  std::optional<double> value() const {
    return count_ == 0 ? std::nullopt : std::optional<double>(sum_ / count_);
  }

 private:
  double sum_ = 0;
  int count_ = 0;
};

}  // namespace robostress
