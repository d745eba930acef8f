#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::calibration {

// The end-effector's way in one replay of a pick-and-place demonstration.
struct Replay {
  std::vector<double> t;           // [s], increasing
  std::vector<Eigen::Vector3d> p;  // end effector, any fixed frame [m]
  std::vector<bool> held;          // the object is in the gripper
};

// When the object was taken and let go: first and last time of the longest stretch in which it is
// held.
struct GraspSpan {
  double start = 0, grasp = 0, release = 0, end = 0;  // [s]; start, end: of the replay
};
// NotFound: nothing was held for kShortestGrasp.
inline constexpr double kShortestGrasp = 0.3;  // [s]
absl::StatusOr<GraspSpan> FindGrasp(const Replay& replay);

// A profile over the phases of a demonstration, so that replays of different length compare:
// kPhases points, evenly from the start (-1) over the grasp (0) to the release (1).
inline constexpr int kPhasesBefore = 50, kPhases = 101;
double PhaseAt(int i);                             // of point i
double TimeAtPhase(const GraspSpan& span, int i);  // [s]

// Positions at the phases of `span`, linear between rows; before the first and after the last row
// the nearest one's.
std::vector<Eigen::Vector3d> AtPhases(const Replay& replay, const GraspSpan& span);

using Profile = std::vector<double>;  // [kPhases] deviation [m]

// |p_perturbed - p_reference| at equal times, on the phases of the reference.
Profile Deviation(const std::vector<Eigen::Vector3d>& perturbed,
                  const std::vector<Eigen::Vector3d>& reference);
std::vector<Eigen::Vector3d> MeanPath(const std::vector<std::vector<Eigen::Vector3d>>& paths);
Profile Mean(const std::vector<Profile>& profiles);
// Sample standard deviation per phase; zero for a single profile.
Profile Spread(const std::vector<Profile>& profiles);

// How much a profile rises at the grasp: its mean over the last three quarters of the carry minus
// that over the second half of the reach [m].
double Rise(const Profile& profile);

}  // namespace robostress::calibration
