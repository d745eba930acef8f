#include "calibration/search/joint_case.h"

#include <cmath>

namespace robostress::calibration {
namespace {

constexpr double kBlock = 0.5;  // [s] windows of inputs that are no motion

int WindowRows(const Rig& rig, int joint, double dt) {
  const JointInput input = rig.joints[joint].input;
  const bool motion = input == JointInput::kPositionTarget || input == JointInput::kTorque;
  return static_cast<int>(std::round((motion ? rig.metric.window_s : kBlock) / dt));
}

}  // namespace

JointCase::JointCase(const Rig& its_rig, const Plant& its_plant,
                     const std::vector<MeasuredLog>& logs, int its_index)
    : rig(its_rig),
      plant(its_plant),
      index(its_index),
      problem(declared().name, MakeTracks(plant, logs, index),
              WindowRows(rig, index, logs.front().dt)),
      metric(rig.metric, problem, WindowRows(rig, index, logs.front().dt)) {}

WindowSet JointCase::Unseen() const {
  WindowSet held_out = problem.OfRole(LogRole::kHeldOut);
  return problem.Rows(held_out) > 0 ? held_out : Fit();
}

LogRole JointCase::UnseenRole() const {
  return metric.Has(LogRole::kHeldOut) ? LogRole::kHeldOut : LogRole::kFit;
}

double JointCase::ProjectedRms(const JointModel& model, const WindowSet& windows) const {
  const Eigen::VectorXd r = problem.Projected(model, windows);
  return r.size() > 0 ? std::sqrt(r.squaredNorm() / static_cast<double>(r.size())) : 0;
}

double JointCase::ProjectedBulk(const JointModel& model, const WindowSet& windows) const {
  const Eigen::VectorXd r = problem.Projected(model, windows);
  std::vector<double> energy;
  std::vector<int> rows;
  Eigen::Index first = 0;
  for (size_t i = 0; i < windows.size(); ++i) {
    rows.push_back(windows[i] ? problem.Rows(problem.windows()[i]) : 0);
    energy.push_back(r.segment(first, rows.back()).squaredNorm());
    first += rows.back();
  }
  const WindowSet bulk = WithoutLargest(energy, rows);
  double sum = 0, count = 0;
  for (size_t i = 0; i < bulk.size(); ++i)
    if (bulk[i]) sum += energy[i], count += rows[i];
  return count > 0 ? std::sqrt(sum / count) : 0;
}

}  // namespace robostress::calibration
