#include "calibration/search/joint_case.h"

#include <algorithm>
#include <cmath>

namespace robostress::calibration {
namespace {

constexpr int kFewWindows = 2;  // of a part of the held-out logs
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
      metric(rig.metric, problem, WindowRows(rig, index, logs.front().dt)) {
  const auto windows = [](const WindowSet& set) { return std::count(set.begin(), set.end(), 1); };
  seals_ = windows(HeldOut(true)) >= kFewWindows && windows(HeldOut(false)) >= kFewWindows;
}

// Stretches count on over the logs, so that logs of one stretch do not all decide.
WindowSet JointCase::HeldOut(bool sealed) const {
  WindowSet chosen = problem.OfRole(LogRole::kHeldOut);
  int stretch = 0;
  const Window* last = nullptr;
  for (size_t i = 0; i < chosen.size(); ++i) {
    if (!chosen[i]) continue;
    const Window& window = problem.windows()[i];
    const double dt = problem.tracks()[window.track].log->dt;
    const auto index = [&](const Window& w) { return std::floor(w.first * dt / kStretch); };
    if (last != nullptr && (last->track != window.track || index(*last) != index(window)))
      ++stretch;
    last = &window;
    chosen[i] = (stretch % 2 == 1) == sealed;
  }
  return chosen;
}

WindowSet JointCase::Unseen() const {
  if (seals_) return HeldOut(false);
  WindowSet held_out = problem.OfRole(LogRole::kHeldOut);
  return problem.Rows(held_out) > 0 ? held_out : Fit();
}

WindowSet JointCase::Sealed() const {
  return seals_ ? HeldOut(true) : problem.OfRole(LogRole::kHeldOut);
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
