#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/fidelity/payload_replay.h"
#include "calibration/fidelity/replay_arm.h"

namespace robostress::calibration {

// One demonstration replayed on the measured arm, with and without the payload.
struct MeasuredReplays {
  std::vector<Replay> loaded, unloaded;
  std::string source;  // for people: which arm
};

// DIR/replays.csv with the header t,x,y,z,held,loaded,replay (any order): time since the replay's
// first command [s], end effector in any fixed frame [m], whether the object is in the gripper
// (0, 1), whether the payload is on (0, 1), number of the replay. Errors name file, line, column
// and value; each replay needs an increasing clock, a reach and a grasp, and there must be at least
// one of either kind.
absl::StatusOr<MeasuredReplays> ReadMeasuredReplays(const std::string& dir);
std::string WriteMeasuredReplays(const MeasuredReplays& measured);

struct SimulatedArm {
  ReplayTask task;
  int layout = 0;
  int replays = 3;
  double payload_kg = 1;
  int64_t seed = 10000;
  // What differs from replay to replay, as standard deviations: where homing leaves the joints
  // (0.2 mrad is 0.1 mm at 0.5 m, the repeatability that makers of such arms state) and where a
  // hand puts the object. Without it replays in simulation would be equal.
  double joint_start = 2e-4;   // [rad]
  double object_place = 1e-3;  // [m]
};

// A simulated arm in place of a real one: friction with true stiction, backlash and compliance at
// their nominal values, no error of gravity compensation; the payload is a mass in the gripper that
// the controller does not know. The demonstration is recorded on this arm, unloaded.
absl::StatusOr<MeasuredReplays> SimulateMeasuredReplays(const SimulatedArm& arm);

// What the comparison needs of them.
struct MeasuredProfiles {
  GraspSpan span;                 // mean of the unloaded replays
  std::vector<Profile> loaded;    // of each loaded replay from the mean unloaded path
  std::vector<Profile> unloaded;  // of each unloaded one from the mean of the others; of one: empty
  Profile vertical;               // z of the mean loaded path over the mean unloaded one [m]
};
absl::StatusOr<MeasuredProfiles> MeasureProfiles(const MeasuredReplays& measured);

}  // namespace robostress::calibration
