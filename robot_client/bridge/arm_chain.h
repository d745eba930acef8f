#pragma once

#include <Eigen/Dense>
#include <Eigen/Geometry>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "common/models/hull.h"
#include "robot_client/robot_arm.h"

namespace robostress::bridge {

// Section model: of a robot file.
struct ModelOptions {
  std::string file;                   // URDF; a relative path is taken from the robot file's folder
  std::vector<std::string> joints;    // its names of the joints; empty: the driver's
  std::string tool;                   // link of it that is the tool's point, and a payload's place
  std::vector<std::string> packages;  // folders that package:// of the file's meshes is in
  // [m] of a link whose meshes are not there: about its frame's origin for table and box; against
  // the arm itself about the line from there to the next joint, of the last up to the tool's point.
  double radius = 0.06;
  std::vector<std::string> ignore;  // "J5-J7", "base-J3": links not watched against each other

  template <class V>
  void Visit(V& v) {
    v.Field("file", file, "URDF of the arm; a relative path begins at this file's folder");
    v.Field("joints", joints, "its names of the joints, from the base on; empty: as the driver's");
    v.Field("tool", tool, "link of it that is the tool's point");
    v.Field("packages", packages,
            "folders in which package://NAME of its meshes is looked for, before those above it");
    v.Field("radius", radius,
            "of a link whose meshes are not there, about the line from its joint to the next [m]");
    v.Field("ignore", ignore, "links not watched against each other: J5-J7, base-J3");
  }
};

// What a joint moves, with everything that is fixed to it, up to the next joint. Its frame is the
// joint's.
struct ChainLink {
  Eigen::Isometry3d T_before_joint;  // of the joint at 0, in the frame before it; first: the base's
  Eigen::Vector3d axis;              // of length 1, in the joint's frame
  double mass = 0;                   // [kg]
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();   // of mass [m]
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();  // about the centre [kg m^2]
};

// Holds a part of a link, in the link's frame; of -1, the base, in the base frame.
struct LinkPart {
  int link;
  Hull shape;
  bool against_table = true, against_box = true, against_itself = true;
};

// Two links by their joints, from 0; -1: the base. The first is nearer to it.
struct LinkPair {
  int first, second;
  auto operator<=>(const LinkPair&) const = default;
};
// Of "J5-J7" or "base-J3", in either order; INVALID_ARGUMENT says what it must be.
absl::StatusOr<LinkPair> ParseLinkPair(const std::string& text, int joints);
std::string LinkPairName(const LinkPair& pair);  // "J5 and J7"

// A link of which not all is watched against a bound.
struct LeftOut {
  int link;
  bool all;  // of its parts
};

// An arm's joints in a row, from the base on; the base link stands upright, its z up.
struct ArmChain {
  std::string file;                                // that it was read from
  std::vector<ChainLink> links;                    // one per joint
  Eigen::Vector3d tool = Eigen::Vector3d::Zero();  // in the frame of the last [m]
  std::vector<LinkPart> body;
  int meshes = 0;                           // that were read
  std::vector<std::string> missing_meshes;  // as the file names them, with the reason
  // Of ChooseLinkPairs: whose distances are watched, two places in `body` each, and links that are
  // too near each other for that, with all parts or with some, or that somebody has left out.
  std::vector<std::pair<int, int>> watched;
  std::vector<LinkPair> too_near, partly_near, ignored;
  std::vector<LeftOut> below_table, below_box;  // of LeaveLowPartsOut
  std::vector<std::string> held;                // joints on the way to the tool that stand at 0
  double touching = 0;       // share of the poses within the limits where watched parts touch
  LinkPair touching_most{};  // links that do in most of them
};

// Reads the chain of `joints` out of a URDF. Joints of the file that are not listed stand at 0. A
// link's shape is that of its <collision>, or where it has none its <visual>: boxes, cylinders,
// spheres and meshes; of meshes that are not there a ball of `radius`; a frame without shape and
// mass is a point. No pairs are chosen yet.
// INVALID_ARGUMENT and NOT_FOUND name file, line or field, value and remedy: a joint that slides,
// joints that are not in a row, one between them that follows a listed one (<mimic>), a mesh that
// is damaged, `limits` beyond where the file says that a joint ends, by which a wrong sign or zero
// is noticed.
absl::StatusOr<ArmChain> ReadArmChain(const std::string& file, const std::string& text,
                                      const std::vector<std::string>& joints,
                                      const ArmLimits& limits, const ModelOptions& options);

}  // namespace robostress::bridge
