#pragma once

#include <Eigen/Core>

namespace robostress {

// What OSC_POSE with uncouple_pos_ori leaves of a Panda's tool at joint positions q [7] [rad]:
//
//   acceleration = C force,   C = A Lambda,  A = J M^-1 J^T,  Lambda = diag(A_pp^-1, A_rr^-1)
//
// in normalised command units (1 = 0.05 m or 0.5 rad), position before orientation, axes of the
// base frame. C is the identity on its diagonal blocks; the others say how a turn moves the tool
// and how a move turns it. Its eigenvalues lie in [0, 2], and near a singular posture towards both
// ends. Kinematics, masses and armatures: robosuite 1.4, robots/panda/robot.xml and
// grippers/panda_gripper.xml, fingers closed. At LIBERO's home posture where `q` is of no Panda
// (other than seven entries) or singular.
Eigen::Matrix<double, 6, 6> PandaCoupling(const Eigen::VectorXd& q);

}  // namespace robostress
