#pragma once

#include <Eigen/Core>
#include <array>

#include "robot_client/piper/protocol.h"

namespace robostress::piper {

// A rigid part in the frame of its link, which is that of kinematics.h: the vendor's description
// puts its frames on the same Denavit-Hartenberg axes.
struct RigidPart {
  double mass = 0;                                    // [kg]
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();   // [m]
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();  // about the centre [kg m^2]
};

// Links 1 to 6 of the vendor's robot description of 2025, without the gripper.
const std::array<RigidPart, kJoints>& LinkParts();
// The gripper's base, in the frame of link 6.
const RigidPart& GripperPart();

// One finger's pad: a box in the frame of link 6 whose y is the only coordinate that moves.
inline constexpr double kPadMass = 0.1;                                  // [kg]
inline constexpr std::array<double, 3> kPadHalf = {0.012, 0.006, 0.03};  // [m]
inline constexpr double kPadHeight = 0.1058;                             // its centre's z [m]
inline constexpr double kGripHeight = 0.1358;  // the point between the finger tips, z [m]
// Inertia of a motor's rotor at its joint (MuJoCo Menagerie's agilex_piper) [kg m^2].
inline constexpr double kArmature = 0.005;

}  // namespace robostress::piper
