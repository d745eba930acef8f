#pragma once

#include <mujoco/mujoco.h>

#include <Eigen/Core>
#include <array>

#include "absl/status/statusor.h"

namespace robostress {

using Vector7d = Eigen::Matrix<double, 7, 1>;
using Matrix7d = Eigen::Matrix<double, 7, 7>;
using Matrix67d = Eigen::Matrix<double, 6, 7>;

// Where a compiled model keeps its Panda, found by robosuite's names. The arm's degrees of freedom
// need not be contiguous, and any other bodies may stand before or after them.
struct PandaModel {
  std::array<int, 7> joint, qpos, dof, motor;  // joint id, address in qpos, in qvel, actuator id
  std::array<int, 2> finger_qpos, finger_dof, finger_motor;
  std::array<int, 2> finger_pad;  // geom ids
  int base_body, hand_body, grip_site;
  Vector7d torque_limit;                          // [Nm], of the motors' ctrlrange
  std::array<double, 2> finger_mid, finger_half;  // [m], of the fingers' ctrlrange

  // kNotFound names the first element that is missing; kInvalidArgument what differs from 500 Hz
  // Euler.
  static absl::StatusOr<PandaModel> Find(const mjModel& model);
};

// The arm as the controller sees it; frames are the world's, twists are (linear, angular).
struct ArmState {
  Vector7d q, dq;          // [rad], [rad/s]
  Eigen::Vector3d p_tool;  // gripper0_grip_site [m]
  Eigen::Matrix3d R_tool;  // gripper0_grip_site
  Matrix67d J;             // of the site: (v, w) = J dq
  Matrix7d M;              // arm block of the mass matrix, armature included [kg m^2]
};

// Reads what mj_step1 (or mj_forward) left in `data`. Allocates nothing.
void ReadArm(const mjModel& model, const mjData& data, const PandaModel& panda, ArmState& arm);

// g_j(q): the torque that holds the arm against gravity at zero velocity, without Coriolis terms
// [Nm]. Joint j carries the subtree of its body, mass m_j and centre c_j, around its axis a_j
// through o_j:
//   g_j = a_j . ((c_j - o_j) x (-m_j gravity)).
// Needs the position stage only. Joints must be hinges, whatever else the scene holds. Allocates
// nothing.
Vector7d GravityTorque(const mjModel& model, const mjData& data, const PandaModel& panda);
// The same in a field of `gravity` [m/s^2], world frame.
Vector7d GravityTorque(const mjModel& model, const mjData& data, const PandaModel& panda,
                       const Eigen::Vector3d& gravity);

}  // namespace robostress
