#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/data/rig.h"
#include "calibration/model/plant.h"
#include "common/joint_errors/effects/effect_library.h"

namespace robostress::calibration {

// An effect with values for all its parameters, in the order of EffectInfo::parameters.
struct EffectInstance {
  const EffectInfo* info = nullptr;
  std::vector<double> values;
  int partner = -1;  // joint of the rig whose motion a coupled effect reads
};

// Everything that the prediction of one joint depends on beside logs and rigid body.
struct JointModel {
  JointInput input = JointInput::kPositionTarget;
  bool hinge = true;
  Servo servo;
  double armature = 0;         // [kg m^2]
  double mass_scale = 1;       // of inertia and gravity, armature excluded
  double damping = 0;          // [Nm s/rad]
  double frictionloss = 0;     // [Nm]
  double stiffness = 0;        // [Nm/rad]
  double spring_rest = 0;      // [rad]
  double torque_offset = 0;    // [Nm]
  double torque_gain = 1;      // of the drive
  double position_offset = 0;  // [rad], of the reading
  // What a log leaves open within one row, free in every fit of a motion: when within its row a
  // command acts (it holds from `command_shift` rows after its time stamp), and how old the
  // position is that servo and gravity act on (integrators and sampled servos differ in it).
  double command_shift = 0;  // [rows]
  double force_lag = 0;      // [s]
  // Whether commands, or a logged torque that drives, go on smoothly from row to row instead.
  bool continuous_command = false;
  std::vector<EffectInstance> effects;
};

// The declared model of joint `index` of a rig.
absl::StatusOr<JointModel> DeclaredModel(const Rig& rig, const Plant& plant, int index);

// The joint of the rig that its coupled effects read, of which there is one; -1: none is coupled.
int PartnerOf(const JointModel& model);

// The number that `path` names: a model parameter ("armature", "servo.kp") or
// "<effect>.<parameter>". NotFound lists what there is.
absl::StatusOr<double*> FindValue(JointModel& model, const std::string& path);

// `model` under a log's overrides that concern `joint`.
absl::StatusOr<JointModel> WithOverrides(JointModel model, const std::string& joint,
                                         const std::map<std::string, double>& overrides);

}  // namespace robostress::calibration
