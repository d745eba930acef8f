#pragma once

#include <tinyxml2.h>

#include <Eigen/Dense>
#include <string>
#include <utility>
#include <vector>

// A robot description in parts, read and checked by urdf_model.cc. Its elements' lines serve
// messages.
namespace robostress::urdf {

struct Pose {
  std::vector<double> xyz = {0, 0, 0};  // [m]
  std::vector<double> rpy = {0, 0, 0};  // [rad] about fixed x, y, z
};

struct Shape {
  std::string kind;  // box, sphere, cylinder, capsule, mesh: its element
  // Attributes by name: size, radius, length [m], filename.
  std::vector<std::pair<std::string, std::string>> attributes;
  Pose origin;
  bool touched = true;  // <collision>; else <visual>
};

// A body.
struct Link {
  std::string name;
  const tinyxml2::XMLElement* element = nullptr;
  double mass = 0;                                    // [kg]; 0: no inertial
  Pose com;                                           // of the inertial in the link's frame
  Eigen::Matrix3d inertia = Eigen::Matrix3d::Zero();  // [kg m^2] in the inertial's frame
  int parent = -1;                                    // index of a joint
  std::vector<int> children;                          // indices of joints
  std::vector<Shape> shapes;                          // to be printed
};

struct Joint {
  std::string name, type, mimic;
  const tinyxml2::XMLElement* element = nullptr;
  int parent = -1, child = -1;  // indices of links
  Pose origin;
  std::vector<double> axis = {1, 0, 0};
  double lower = 0, upper = 0;       // [rad] or [m]
  double damping = 0, friction = 0;  // [Nm s/rad, Nm] or [N s/m, N]
  double effort = 0;                 // [Nm] or [N]; 0: not said
  bool moves = false, limited = false;
  double multiplier = 1, offset = 0;  // of mimic, to be printed
};

// [Nm, N], [rad/s, m/s]: stands where nobody says a limit, and is read as none; 0 would forbid
// every motion to others.
inline constexpr double kUnknownLimit = 1e6;

// URDF of the parts, with numbers that read back equal; joints that do not move are fixed. MuJoCo's
// reader is told to keep links that are fixed to others.
std::string Print(const std::vector<Link>& links, const std::vector<Joint>& joints);

}  // namespace robostress::urdf
