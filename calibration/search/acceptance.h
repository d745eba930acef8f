#pragma once

#include <string>

#include "calibration/search/traced_model.h"

namespace robostress::calibration {

// What an added effect must show to be accepted.
class Acceptance {
 public:
  static constexpr double kMaxPValue = 0.01;
  static constexpr double kMinCvGain = 0.02;
  // Of the cross-validated error: so much is no chance, whatever the signature promised where the
  // declared parameters stood in for the effect.
  static constexpr double kNoChance = 0.5;

  // `floor` [rad]: the noise's share of a projected residual. `problem` outlives this.
  Acceptance(const JointProblem& problem, const WindowSet& fit_windows, double floor)
      : problem_(problem), fit_windows_(fit_windows), floor_(floor) {}

  // Cross-validated energy above the noise's, per row.
  double Excess(const TracedModel& model) const;
  // Whether `model` leaves clearly less above the noise than `base`.
  bool ExplainsMore(const TracedModel& base, const TracedModel& model) const;
  // Why `model` is not accepted on top of `base`, whose effects are its first; empty: it is.
  // `p`: of the gain that its signature promised.
  std::string Objection(const TracedModel& base, const TracedModel& model, double p) const;
  // What of it concerns the size of an effect: beyond its uncertainty, off its bounds and the same
  // over folds.
  std::string SizeObjection(const TracedModel& model, const std::string& added) const;
  // Why the fit can not be what the machine is, however well it predicts (plausibility.h). Empty:
  // it can.
  std::string Doubt(const TracedModel& model) const;

 private:
  double BicGain(const TracedModel& base, const TracedModel& model) const;

  const JointProblem& problem_;
  const WindowSet fit_windows_;
  const double floor_;
};

}  // namespace robostress::calibration
