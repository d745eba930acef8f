#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "common/joint_errors/scenario_file.h"

namespace robostress::calibration {

// Which joints of a simulated arm show what a joint of a rig was found to have.
struct MappedJoint {
  std::vector<int> arm_joints;  // 0: J1
  // Of torques, stiffnesses and payloads: 1 keeps the physical values. The arm's joint may be
  // larger or smaller than the rig's; angles, times and velocities are kept in any case.
  double torque_ratio = 1;
};
using JointMap = std::map<std::string, MappedJoint>;  // by name of the rig's joint

// Arguments of --map: "hinge=J4", "hinge=J2+J4", "hinge=J4:2.5" (torque_ratio 2.5), several
// separated by commas; "own" maps joints that are called J4, joint4 or anything that ends in
// joint4 to J4. Errors list the rig's joints.
absl::StatusOr<JointMap> ParseJointMap(const std::vector<std::string>& arguments, const Rig& rig,
                                       const RobotDescription& arm);

struct ScenarioOutput {
  ScenarioFile scenario;
  std::vector<std::string> notes;  // what could not be carried over, and why
};

// What `after` has and `declared` has not, as a scenario on Clean: effects that were added, at the
// arm's joints that the map names. Fitted parameters of the declared model are of the rig's own
// body and stay there. Effects of stage command act on what the rig's servo was given and, on the
// arm, on its torque command; a rate limit has no meaning there and is left out with a note, as are
// effects of joints that the map does not name and values beyond what a scenario may give the arm's
// joint, with the remedy. FailedPrecondition where nothing was added or nothing is left.
absl::StatusOr<ScenarioOutput> ScenarioOfRig(const Rig& declared, const Rig& after,
                                             const JointMap& map, const std::string& title,
                                             const RobotDescription& arm);

}  // namespace robostress::calibration
