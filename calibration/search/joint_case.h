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
  // Held out where there is something held out, else fitted.
  WindowSet Unseen() const;
  LogRole UnseenRole() const;
  // Of residuals without what the windows' unknown starts explain.
  double ProjectedRms(const JointModel& model, const WindowSet& windows) const;
  // The same without the tenth of the windows that is farthest off.
  double ProjectedBulk(const JointModel& model, const WindowSet& windows) const;

  const Rig& rig;
  const Plant& plant;
  const int index;
  JointProblem problem;
  const MetricFit metric;
};

}  // namespace robostress::calibration
