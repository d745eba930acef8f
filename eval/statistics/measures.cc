#include "eval/statistics/measures.h"

#include <cmath>

namespace robostress {
namespace {

// sqrt(sum numerator / sum denominator) over the episodes that have both.
class PooledRatio {
 public:
  void Add(const std::optional<double>& numerator, const std::optional<double>& denominator) {
    if (!numerator || !denominator) return;
    numerator_ += *numerator;
    denominator_ += *denominator;
  }
  std::optional<double> value() const {
    return denominator_ > 0 ? std::optional<double>(std::sqrt(numerator_ / denominator_))
                            : std::nullopt;
  }

 private:
  double numerator_ = 0, denominator_ = 0;
};

}  // namespace

Measures MeasuresOf(const Units& units) {
  Mean residual, tracking, intent, action, clipped, distance;
  PooledRatio residual_pooled, intent_pooled;
  for (const UnitResult* unit : units) {
    for (const EpisodeRow& row : unit->episodes) {
      residual.Add(row.residual);
      tracking.Add(row.residual_tracking);
      intent.Add(row.intent);
      action.Add(row.mean_abs_action);
      clipped.Add(row.clipped_share);
      residual_pooled.Add(row.eta_sq, row.a_sq);
      intent_pooled.Add(row.intent_eta_sq, row.intent_a_sq);
    }
    if (!unit->episodes.empty()) distance.Add(unit->episodes.back().adapter_distance);
  }
  return {residual.value(),      residual_pooled.value(), tracking.value(), intent.value(),
          intent_pooled.value(), action.value(),          clipped.value(),  distance.value()};
}

Measures MeanMeasures(const std::vector<Measures>& all) {
  Measures mean;
  for (const auto field :
       {&Measures::residual_mean, &Measures::residual_pooled, &Measures::tracking_mean,
        &Measures::intent_mean, &Measures::intent_pooled, &Measures::mean_abs_action,
        &Measures::clipped_share, &Measures::adapter_distance}) {
    Mean m;
    for (const Measures& measures : all) m.Add(measures.*field);
    mean.*field = m.value();
  }
  return mean;
}

}  // namespace robostress
