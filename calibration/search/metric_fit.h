#pragma once

#include <string>
#include <vector>

#include "calibration/data/rig.h"
#include "calibration/search/cross_validation.h"
#include "calibration/search/subplex.h"

namespace robostress::calibration {

// The error that a rig's metric makes of a model's predictions of one joint, and the parameters
// that are best by it. A search compares models on projected residuals of short free runs, which
// are smooth in the parameters; a metric is of free runs as they are, perhaps of whole ones, in
// which a joint sticks or slips.
class MetricFit {
 public:
  // `search`: the problem of the search, which must outlive this; `window` [rows] of the metric.
  MetricFit(const Metric& metric, const JointProblem& search, int window);

  // Whether it is not the RMS that the search's own fits are about.
  bool own() const { return type_ != Metric::Type::kRms; }
  // [rad or m; Nm or N of input inverse] 0 where no log has the role.
  double Error(const JointModel& model, LogRole role) const;
  double Floor(LogRole role) const;
  // Of windows of the search's problem.
  double Error(const JointModel& model, const WindowSet& windows) const;
  double Floor(const WindowSet& windows) const;
  bool Has(LogRole role) const;

  // Refitted to the fit logs from `from`: least squares, and for a metric of its own subplex
  // (NLopt) on the metric itself.
  Hypothesis Best(const Hypothesis& from) const;
  // Gives a search's fit the parameters that are best for the metric, where more than noise is left
  // of it.
  void Refit(JointFit& fit) const;
  // Of all fit logs, each fold predicted by what is best for the others, from `best` for all.
  double LeftOut(const Hypothesis& best, Folds folds) const;

 private:
  SubplexMinimum Descend(const Hypothesis& from, const WindowSet& windows) const;
  // From what is best for all windows to what is best for these.
  Hypothesis Again(Hypothesis best, const WindowSet& windows) const;

  const Metric::Type type_;
  JointProblem problem_;  // residuals as they are
  const JointProblem& search_;
};

}  // namespace robostress::calibration
