#pragma once

#include <vector>

#include "calibration/data/rig.h"
#include "calibration/model/plant.h"
#include "calibration/search/joint_problem.h"
#include "calibration/search/metric_fit.h"

namespace robostress::calibration {

// One joint of a rig with its logs: the problem that a search solves, and the metric that errors
// are reported of. `rig`, `plant` and `logs` outlive it.
struct JointCase {
  JointCase(const Rig& rig, const Plant& plant, const std::vector<MeasuredLog>& logs, int index);
  JointCase(const JointCase&) = delete;

  const RigJoint& declared() const { return rig.joints[index]; }
  WindowSet Fit() const { return problem.OfRole(LogRole::kFit); }
  // Of the held-out logs every other stretch of kStretch: those that decide, and those that
  // decide nothing, of which errors are reported. Where the held-out logs are too short both are
  // all of them; where there are none, `Unseen` is what was fitted and `Sealed` is empty.
  WindowSet Unseen() const;
  WindowSet Sealed() const;
  bool seals() const { return seals_; }
  static constexpr double kStretch = 1.0;  // [s]
  // Of residuals without what the windows' unknown starts explain.
  double ProjectedRms(const JointModel& model, const WindowSet& windows) const;
  // The same without the tenth of the windows that is farthest off.
  double ProjectedBulk(const JointModel& model, const WindowSet& windows) const;

  const Rig& rig;
  const Plant& plant;
  const int index;
  JointProblem problem;
  const MetricFit metric;

 private:
  WindowSet HeldOut(bool sealed) const;
  bool seals_ = false;
};

}  // namespace robostress::calibration
