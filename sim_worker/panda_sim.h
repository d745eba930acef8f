#pragma once

#include <mujoco/mujoco.h>

#include <Eigen/Core>
#include <functional>
#include <memory>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "common/joint_errors/scenarios.h"
#include "common/types.h"
#include "common/unit_config.h"
#include "sim_worker/joint_log.h"

namespace robostress {

class JointChain;
class OscController;

// Compiled models are immutable and shared between simulators.
using SharedModel = std::shared_ptr<const mjModel>;
// Compiles MJCF text; `source` names it in errors.
absl::StatusOr<SharedModel> CompileModel(const std::string& source, const std::string& mjcf);

// A Panda with its gripper in a compiled scene: operational-space control at 500 Hz, joint errors,
// 20 Hz commands. One thread. Joints, motors, sites and cameras carry robosuite's names.
class PandaSim {
 public:
  static absl::StatusOr<std::unique_ptr<PandaSim>> Create(SharedModel model,
                                                          const SimOptions& options);
  ~PandaSim();

  // Errors to inject from the next Reset on; horizon is the suite's [control steps], the length of
  // a ramp.
  void SetScenario(const Scenario& scenario, int horizon);
  // qpos [nq], qvel zero. Hidden error states, controller goal, gripper and progress start anew.
  // home: the controller's null-space posture [7] (robosuite: the reset pose).
  absl::Status Reset(absl::Span<const double> qpos, const Eigen::Matrix<double, 7, 1>& home);
  // `steps` control steps with a zero command and an open gripper at progress 0, errors on.
  absl::Status Settle(int steps);
  // One such step with a command of the caller's.
  absl::Status SettleWith(const Eigen::Matrix<double, 7, 1>& command);
  // One control step (25 sub-steps). command [7]: clipped to +-1.
  absl::Status Step(const Eigen::VectorXf& command);
  absl::Status StepExact(const Eigen::Matrix<double, 7, 1>& command);

  RobotState Measure() const;
  // Held: both finger pads touch one and the same free body's geoms.
  bool GraspDetected() const;
  int held_body() const;  // body id or -1
  int steps_taken() const;

  const mjModel& model() const;
  SharedModel shared_model() const;
  const mjData& data() const;
  mjData& mutable_data();
  // What observations are made of: positions, velocities and kinematics, nothing else of mjData.
  // data(), unless observations are late.
  const mjData& observed() const;
  const OscController& controller() const;
  const JointChain& joint_chain() const;
  // Called after every sub-step, before the next one's forward passes.
  void OnSubStep(std::function<void()> call);
  // Called for every sub-step, those of settling too.
  void OnJointSample(std::function<void(const JointSample&)> call);
  // Called once per control step when data() holds positions of its end with poses and contacts of
  // the start of its last sub-step: robosuite looks at success there.
  void OnIntegrated(std::function<void()> call);

  // Everything that a continuation depends on, for branching (expert labels) and restoring.
  struct Snapshot;
  std::shared_ptr<const Snapshot> Save() const;
  void Restore(const Snapshot& snapshot);
  // The same motion with the hidden states of its own joint errors, of another simulator of the
  // same scene.
  void RestoreMotion(const Snapshot& snapshot);

 private:
  struct Impl;
  explicit PandaSim(std::unique_ptr<Impl> impl);
  std::unique_ptr<Impl> impl_;
};

}  // namespace robostress
