#pragma once

#include <Eigen/Core>
#include <vector>

#include "absl/status/statusor.h"
#include "adapter/nominal_arm.h"
#include "common/types.h"
#include "common/wire/openpi_value.h"
#include "server/proxy/arm_profile.h"

namespace robostress {

// The measured state in an observation: the tool's pose, or the joints. INVALID_ARGUMENT: a key is
// missing, too few numbers, one that is not finite, a quaternion of another length than 1.
absl::StatusOr<RobotState> ReadArmState(const OpenpiValue& observation, const ArmProfile& profile);

// What an arm did with some steps of a chunk, in a method's numbers (ArmProfile::scale).
struct ArmMotion {
  ExecutedChunk chunk;  // 7 numbers a command, or the joints and one more; the last is always 0
  // [columns] what the arm did beyond what was expected of it, all steps together; of joints: where
  // they are beyond the last target [rad].
  Eigen::VectorXd surprise;
  bool jump = false;  // more of it than ProxyLimits allows
};

// Makes executed chunks of what a proxy sees. Most clients show the state at a chunk's ends only.
// Then the states between are those of a nominal arm that gets the commands as they were sent, with
// the difference that it ends with spread evenly over the steps:
//
//   dx_i = n_i + (D - sum n) / k
//
// symbol  name                 unit
// dx      displacement         a method's numbers
// n       of the nominal arm   a method's numbers
// D       measured, of all k   a method's numbers
//
// so that an arm that answers as the nominal one shows no residual in any step. Of joints only the
// last step counts as measured: where they stand then is compared with the last target.
class ArmMotionReader {
 public:
  explicit ArmMotionReader(const ArmProfile& profile)
      : profile_(profile), arm_(profile.nominal_arm()) {}

  void StartEpisode() { arm_.Reset(); }
  // `own`, `sent` [steps, columns]: what the policy asked for and what the client was given.
  ArmMotion Between(const RobotState& before, const RobotState& after, const Eigen::MatrixXd& own,
                    const Eigen::MatrixXd& sent);
  // The same with every state measured [steps + 1].
  ArmMotion Measured(const std::vector<RobotState>& states, const Eigen::MatrixXd& own,
                     const Eigen::MatrixXd& sent);

 private:
  ExecutedChunk Commands(const Eigen::MatrixXd& own, const Eigen::MatrixXd& sent) const;
  // [steps, 6] of the nominal arm, which goes on.
  Eigen::MatrixXd Nominal(const ExecutedChunk& chunk);
  // Of the ends, given what was expected [6].
  void Compare(const RobotState& before, const RobotState& after, const Eigen::VectorXd& expected,
               ArmMotion& motion) const;
  void CompareJoints(const RobotState& before, const RobotState& after, ArmMotion& motion) const;
  // [6] from one state to the other.
  Eigen::VectorXd Displacement(const RobotState& before, const RobotState& after) const;
  double meters() const;   // of a method's 1
  double radians() const;  // the same of a rotation

  const ArmProfile profile_;
  NominalArm arm_;
};

}  // namespace robostress
