#include "calibration/fidelity/payload_replay.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_format.h"
#include "common/check.h"

namespace robostress::calibration {

absl::StatusOr<GraspSpan> FindGrasp(const Replay& replay) {
  GraspSpan span;
  double longest = 0;
  for (size_t i = 0; i < replay.t.size();) {
    size_t j = i;
    while (j < replay.t.size() && replay.held[j]) ++j;
    if (j > i && replay.t[j - 1] - replay.t[i] > longest) {
      longest = replay.t[j - 1] - replay.t[i];
      span.grasp = replay.t[i], span.release = replay.t[j - 1];
    }
    i = j + 1;
  }
  if (longest < kShortestGrasp) {
    return absl::NotFoundError(
        absl::StrFormat("nothing is held for %.1f s (longest: %.2f s)", kShortestGrasp, longest));
  }
  span.start = replay.t.front(), span.end = replay.t.back();
  if (span.grasp <= span.start)
    return absl::NotFoundError("the object is held from the start; there is no reach before it");
  return span;
}

double PhaseAt(int i) {
  return i <= kPhasesBefore
             ? static_cast<double>(i) / kPhasesBefore - 1
             : static_cast<double>(i - kPhasesBefore) / (kPhases - 1 - kPhasesBefore);
}

double TimeAtPhase(const GraspSpan& span, int i) {
  const double phase = PhaseAt(i);
  return phase <= 0 ? span.grasp + phase * (span.grasp - span.start)
                    : span.grasp + phase * (span.release - span.grasp);
}

std::vector<Eigen::Vector3d> AtPhases(const Replay& replay, const GraspSpan& span) {
  RS_CHECK(!replay.t.empty());
  std::vector<Eigen::Vector3d> path;
  for (int i = 0; i < kPhases; ++i) {
    const double t = TimeAtPhase(span, i);
    const auto after = std::lower_bound(replay.t.begin(), replay.t.end(), t) - replay.t.begin();
    if (after == 0 || after == static_cast<long>(replay.t.size())) {
      path.push_back(after == 0 ? replay.p.front() : replay.p.back());
      continue;
    }
    const double s = (t - replay.t[after - 1]) / (replay.t[after] - replay.t[after - 1]);
    path.push_back((1 - s) * replay.p[after - 1] + s * replay.p[after]);
  }
  return path;
}

Profile Deviation(const std::vector<Eigen::Vector3d>& perturbed,
                  const std::vector<Eigen::Vector3d>& reference) {
  Profile profile(kPhases);
  for (int i = 0; i < kPhases; ++i) profile[i] = (perturbed[i] - reference[i]).norm();
  return profile;
}

std::vector<Eigen::Vector3d> MeanPath(const std::vector<std::vector<Eigen::Vector3d>>& paths) {
  std::vector<Eigen::Vector3d> mean(kPhases, Eigen::Vector3d::Zero());
  for (const auto& path : paths) {
    for (int i = 0; i < kPhases; ++i) mean[i] += path[i] / static_cast<double>(paths.size());
  }
  return mean;
}

Profile Mean(const std::vector<Profile>& profiles) {
  Profile mean(kPhases, 0);
  for (const Profile& profile : profiles) {
    for (int i = 0; i < kPhases; ++i) mean[i] += profile[i] / static_cast<double>(profiles.size());
  }
  return mean;
}

Profile Spread(const std::vector<Profile>& profiles) {
  const Profile mean = Mean(profiles);
  Profile spread(kPhases, 0);
  if (profiles.size() < 2) return spread;
  for (int i = 0; i < kPhases; ++i) {
    double squares = 0;
    for (const Profile& profile : profiles) squares += std::pow(profile[i] - mean[i], 2);
    spread[i] = std::sqrt(squares / static_cast<double>(profiles.size() - 1));
  }
  return spread;
}

double Rise(const Profile& profile) {
  double before = 0, after = 0;
  int n_before = 0, n_after = 0;
  for (int i = 0; i < kPhases; ++i) {
    if (PhaseAt(i) >= -0.5 && PhaseAt(i) < 0) before += profile[i], ++n_before;
    if (PhaseAt(i) >= 0.25) after += profile[i], ++n_after;
  }
  return after / n_after - before / n_before;
}

}  // namespace robostress::calibration
