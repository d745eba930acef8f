#pragma once

#include <Eigen/Core>

namespace robostress {

// How a Panda's tool accelerates under OSC_POSE with uncouple_pos_ori, which compensates gravity
// and the joints' velocity forces,
//
//   x'' = C f + J' q',   C = A Lambda,  A = J M^-1 J^T,  Lambda = diag(A_pp^-1, A_rr^-1)
//
// f [6] the controller's kp e - kd x'; [m] and [rad], position before orientation, axes of the base
// frame. Kinematics and masses: robosuite 1.4, robots/panda/robot.xml and
// grippers/panda_gripper.xml, fingers closed; armatures as its robots set them, 5 / joint's number.
struct PandaDynamics {
  // The identity on its diagonal blocks; the others say how a turn moves the tool and a move turns
  // it. Eigenvalues in [0, 2], near a singular posture towards both ends.
  Eigen::Matrix<double, 6, 6> coupling = Eigen::Matrix<double, 6, 6>::Identity();
  // J' q' [m/s^2], [rad/s^2]: a tool that swings about the base falls in.
  Eigen::Matrix<double, 6, 1> drift = Eigen::Matrix<double, 6, 1>::Zero();

  // No velocity of a Panda is above it, with a margin: what claims to be says nothing.
  static constexpr double kMaxVelocity = 4;  // [rad/s]

  // Joint positions [7] [rad], velocities [7] [rad/s]. The coupling of LIBERO's home posture where
  // positions are of no Panda (other than seven) or nearly singular; a drift where there are seven
  // velocities up to kMaxVelocity besides.
  static PandaDynamics At(const Eigen::VectorXd& q, const Eigen::VectorXd& dq);
};

}  // namespace robostress
