#pragma once

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "robot_client/robot_arm.h"

namespace robostress::bridge {

// Section model: of a robot file.
struct ModelOptions {
  std::string file;                 // URDF; a relative path is taken from the robot file's folder
  std::vector<std::string> joints;  // its names of the joints; empty: the driver's
  std::string tool;                 // link of it that is the tool's point, and a payload's place
  double radius = 0.06;             // [m] of a link whose shape is a mesh, about its frame's origin

  template <class V>
  void Visit(V& v) {
    v.Field("file", file, "URDF of the arm; a relative path begins at this file's folder");
    v.Field("joints", joints, "its names of the joints, from the base on; empty: as the driver's");
    v.Field("tool", tool, "link of it that is the tool's point");
    v.Field("radius", radius, "of a link whose shape is a mesh, about its frame's origin [m]");
  }
};

// A ball; the hull of a link's balls holds the link.
struct Ball {
  Eigen::Vector3d centre;  // in the link's frame [m]
  double radius;           // [m]
};

// What a joint moves, with everything that is fixed to it, up to the next joint. Its frame is the
// joint's.
struct ChainLink {
  Eigen::Isometry3d T_before_joint;  // of the joint at 0, in the frame before it; first: the base's
  Eigen::Vector3d axis;              // of length 1, in the joint's frame
  double mass = 0;                   // [kg]
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();   // of mass [m]
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();  // about the centre [kg m^2]
  std::vector<Ball> shape;
};

// An arm's joints in a row, from the base on; the base link stands upright, its z up.
struct ArmChain {
  std::string file;                                // that it was read from
  std::vector<ChainLink> links;                    // one per joint
  Eigen::Vector3d tool = Eigen::Vector3d::Zero();  // in the frame of the last [m]
};

// Reads the chain of `joints` out of a URDF. Joints of the file that are not listed stand at 0. A
// link's shape is that of its <collision>: boxes, cylinders and spheres; of meshes a ball of
// `radius`; a frame without shape and mass is a point.
// INVALID_ARGUMENT and NOT_FOUND name file, line or field, value and remedy: a joint that slides,
// joints that are not in a row, `limits` beyond where the file says that a joint ends, by which a
// wrong sign or zero is noticed.
absl::StatusOr<ArmChain> ReadArmChain(const std::string& file, const std::string& text,
                                      const std::vector<std::string>& joints,
                                      const ArmLimits& limits, const ModelOptions& options);

}  // namespace robostress::bridge
