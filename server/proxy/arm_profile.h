#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "adapter/method_options.h"
#include "adapter/nominal_arm.h"
#include "common/remote_options.h"
#include "common/unit_config.h"

namespace robostress {

// Which numbers of a dialect's state, its parts in a row, are what. Indices from 0.
struct StateLayout {
  std::vector<int> position;  // [3] of the tool in the base frame [m]
  std::vector<int> rotation;  // of the tool in the base frame, as `rotation_form` says; or none
  std::string rotation_form = "axis_angle";
  std::vector<int> joints;  // [rad], in the order of the action's

  template <class V>
  void Visit(V& v) {
    v.Field("position", position, "indices of x, y, z of the tool in the base frame [m]");
    v.Field("rotation", rotation, "indices of its rotation; none: not measured");
    v.Field("rotation_form", rotation_form,
            "axis_angle (3 numbers [rad]), quaternion_wxyz or quaternion_xyzw (4 numbers)");
    v.Field("joints", joints, "indices of the joint angles [rad], in the order of the action's");
  }
};

// Which columns of an action are what; all others are never touched.
struct ActionLayout {
  int size = 7;
  std::vector<int> translation, rotation, joints;
  // What 1 of the action asks for, and what a method counts as 1: the most that a step asks for.
  double translation_unit = 0.05, translation_full = 0;  // [m]; full 0: the unit
  double rotation_unit = 0.5, rotation_full = 0;         // [rad]
  std::vector<double> low, high;                         // [size] that a correction may not pass

  template <class V>
  void Visit(V& v) {
    v.Field("size", size, "numbers of an action");
    v.Field("translation", translation, "columns of the tool's displacement x, y, z");
    v.Field("rotation", rotation, "columns of its rotation x, y, z; none: never touched");
    v.Field("joints", joints, "columns of the joint targets [rad]");
    v.Field("translation_unit", translation_unit, "displacement that 1 asks for [m]");
    v.Field("translation_full", translation_full,
            "the most that a step asks for [m], a method's 1; 0: translation_unit");
    v.Field("rotation_unit", rotation_unit, "rotation that 1 asks for [rad]");
    v.Field("rotation_full", rotation_full, "the same of a rotation [rad]");
    v.Field("low", low, "least value of each column that a correction may reach; empty: none");
    v.Field("high", high, "greatest, the same");
  }
};

// How a healthy arm of this kind answers a delta command (adapter/nominal_arm.h).
struct NominalResponse {
  GoalReference goal_reference = GoalReference::kAchieved;
  double stiffness = 150, damping_ratio = 1;  // [1/s^2]
  int sub_steps = 25;

  template <class V>
  void Visit(V& v) {
    v.Choice("goal_reference", goal_reference,
             {{"achieved", GoalReference::kAchieved}, {"desired", GoalReference::kDesired}},
             "goal of a delta: achieved pose + delta, or previous goal + delta");
    v.Field("stiffness", stiffness, "kp of its controller [1/s^2]");
    v.Field("damping_ratio", damping_ratio, "1: critically damped");
    v.Field("sub_steps", sub_steps, "of the controller in one control step");
  }
};

struct ProxyLimits {
  // One for all columns that are corrected, or one each (translation, rotation, or joints), in the
  // action's own units; empty: half of a full step, or 0.05 rad of a joint.
  std::vector<double> correction;
  std::vector<double> rate;  // per second; empty: four times `correction`
  // What the arm may be off from what was expected of it between two observations, beside one and a
  // half times what it was to move: more is another episode, or another robot.
  double jump_m = 0.03, jump_rad = 0.3;
  double pause_s = 2;  // beyond the time that the steps take; longer is another episode

  template <class V>
  void Visit(V& v) {
    v.Field("correction", correction,
            "greatest correction of each corrected column, or one for all [action units]");
    v.Field("rate", rate, "greatest change of it in a second [action units/s]");
    v.Field("jump_m", jump_m, "surprise between two observations that counts as a jump [m]");
    v.Field("jump_rad", jump_rad, "the same of rotation and joints [rad]");
    v.Field("pause_s", pause_s, "pause after which the arm is met anew [s]");
  }
};

// A robot as the proxy must know it: the file robot.yaml.
struct ArmProfile {
  std::string name = "robot";
  std::string control_space;  // "end_effector" or "joint"
  std::string dialect = "libero";
  double rate_hz = 20;    // of the control steps
  bool real_time = true;  // false: a simulator, whose steps do not keep the clock's time
  int first_step = 0, execute_steps = 0;  // of a chunk, that its client executes
  bool asynchronous = false;              // it moves on while it waits
  StateLayout state;
  ActionLayout action;
  std::vector<std::string> joint_names;  // for recordings; empty: joint_1 ...
  NominalResponse nominal;
  double observer_bandwidth = 2;  // of method dob [1/s]
  ProxyLimits limits;
  std::string method = "ours_following";
  std::vector<std::string> method_options;

  OpenpiDialect keys;  // of `dialect`; not in the file

  bool joint_space() const { return control_space == "joint"; }
  // Columns that may be corrected: translation and rotation, or joints.
  std::vector<int> columns() const;
  // What they are called: x, y, z, roll, pitch, yaw, or the joints' names.
  std::vector<std::string> axes() const;
  // [columns] a method's number is the action's times this.
  Eigen::VectorXd scale() const;
  // [columns] of each, in a method's numbers; the rate for one control step.
  Eigen::VectorXd correction_limit() const;
  Eigen::VectorXd step_limit() const;
  NominalArmOptions nominal_arm() const;

  template <class V>
  void Visit(V& v) {
    v.Field("name", name, "of the robot");
    v.Field("control_space", control_space,
            "what an action is: end_effector (deltas of the tool) or joint (absolute targets)");
    v.Field("dialect", dialect, "keys of the messages: libero, aloha, droid ..., or FILE.yaml");
    v.Field("rate_hz", rate_hz, "control steps in a second");
    v.Field("real_time", real_time, "false: a simulator, which has a time of its own");
    v.Field("first_step", first_step, "of a chunk that the client executes, from 0");
    v.Field("execute_steps", execute_steps, "how many it executes before it asks again");
    v.Field("asynchronous", asynchronous,
            "true: it moves on while it waits, and enters an answer at the row that is due since "
            "the observation");
    v.Section("state", state, "which numbers of the state are what");
    v.Section("action", action, "which columns of an action are what");
    v.Field("joint_names", joint_names, "as recordings name them");
    v.Section("nominal", nominal, "a healthy arm's answer to a delta");
    v.Field("observer_bandwidth", observer_bandwidth, "of method dob [1/s]");
    v.Section("limits", limits, "what a correction may be");
    v.Field("method", method, "ours_following, ours_integral, direct, gain, dob or base");
    v.Field("method_options", method_options, "key=value over the method's own");
  }
};

// INVALID_ARGUMENT names field, value and limit; a control space that is not understood is one.
absl::Status CheckArmProfile(const ArmProfile& profile);
// The file, checked; a dialect's file is looked for beside it.
absl::StatusOr<ArmProfile> LoadArmProfile(const std::string& file);

// The profile's method with `overrides` over its options. tracking_gain is the nominal arm's own
// where nobody says another. INVALID_ARGUMENT: one that needs weights, another space, or the
// policy's inputs.
absl::StatusOr<MethodOptions> MethodOf(const ArmProfile& profile,
                                       const std::vector<std::string>& overrides = {});

}  // namespace robostress
