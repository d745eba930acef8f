#include "robot_client/piper/piper_model.h"

#include <algorithm>
#include <limits>

#include "robot_client/capsule.h"
#include "robot_client/piper/link_inertia.h"

namespace robostress::piper {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kGravity = 9.81;  // [m/s^2]

// A capsule in the frame of a link; link 0 is the base, 6 carries the gripper.
struct LinkCapsule {
  int link;
  std::array<double, 3> from, to;  // [m]
  double radius;                   // [m]
};
// Against the arm itself: along the links. On its rest the vendor's shapes are 20 mm apart, and
// capsules that hold them would meet.
constexpr LinkCapsule kAlong[] = {
    {0, {0, 0, 0}, {0, 0, 0.07}, 0.06},
    {1, {0, 0, -0.05}, {0, 0, 0.01}, 0.045},
    {2, {0.02, 0, 0}, {0.27, 0, 0}, 0.035},
    {3, {0, -0.02, 0}, {-0.022, -0.19, 0}, 0.032},
    {4, {0, 0, -0.05}, {0, 0, 0.01}, 0.03},
    {5, {0, -0.01, 0}, {0, -0.06, 0}, 0.028},
    {6, {0, -0.02, 0.035}, {0, 0.02, 0.035}, 0.042},
};
// Against table and box: they hold the shapes of the vendor's description (Piper_ros,
// piper_description, without its fingers), rounded up to a millimetre.
constexpr LinkCapsule kAround[] = {
    {2, {0, 0, 0}, {0.027, -0.005, 0.001}, 0.056},
    {2, {0.225, -0.029, -0.003}, {0.287, -0.002, 0}, 0.058},
    {2, {0.172, -0.032, 0}, {0.079, -0.011, 0}, 0.029},
    {3, {-0.022, -0.214, 0}, {-0.022, -0.083, 0}, 0.030},
    {3, {0, 0, -0.030}, {-0.019, -0.048, -0.023}, 0.032},
    {3, {0, 0.001, 0.019}, {-0.018, -0.044, 0.010}, 0.036},
    {4, {0, 0.006, -0.016}, {0, 0.006, 0.001}, 0.041},
    {5, {0, -0.090, 0.001}, {0, -0.090, 0.001}, 0.030},
    {5, {0.001, -0.008, -0.023}, {0, -0.037, 0.001}, 0.034},
    {6, {0, 0.001, 0.007}, {-0.001, 0.001, 0.007}, 0.031},
    {6, {-0.028, -0.038, 0.051}, {-0.028, 0.041, 0.051}, 0.014},
    {6, {0.004, -0.054, 0.052}, {0.004, 0.056, 0.052}, 0.028},
};
constexpr double kPadRadius = 0.0134;  // of the capsules of the two pads [m]
constexpr int kPads = 4;

struct Placed {
  int link;
  Capsule capsule;  // in the base frame
};

Vector3d Vec(const std::array<double, 3>& v) { return {v[0], v[1], v[2]}; }

JointVector Joints(const ArmVector& v) {
  JointVector q;
  std::copy_n(v.begin(), kJoints, q.begin());
  return q;
}

// The capsules and the pads.
template <size_t kCount>
std::array<Placed, kCount + kPads> Place(const LinkCapsule (&capsules)[kCount],
                                         const std::array<Eigen::Isometry3d, kJoints>& T_base_link,
                                         double opening) {
  const auto in_base = [&](int link, const Vector3d& p) -> Vector3d {
    return link == 0 ? p : Vector3d(T_base_link[link - 1] * p);
  };
  std::array<Placed, kCount + kPads> parts;
  size_t n = 0;
  for (const LinkCapsule& c : capsules)
    parts[n++] = {c.link, {in_base(c.link, Vec(c.from)), in_base(c.link, Vec(c.to)), c.radius}};
  for (const double side : {-1.0, 1.0}) {
    const double y = side * (kPadHalf[1] + 0.5 * std::clamp(opening, 0.0, 0.1));
    parts[n++] = {kJoints,
                  {in_base(kJoints, {0, y, kPadHeight - kPadHalf[2]}),
                   in_base(kJoints, {0, y, kPadHeight + kPadHalf[2] - kPadRadius}), kPadRadius}};
    const double tip = kPadHeight + kPadHalf[2] - kPadHalf[1], x = kPadHalf[0] - kPadHalf[1];
    parts[n++] = {kJoints,
                  {in_base(kJoints, {-x, y, tip}), in_base(kJoints, {x, y, tip}), kPadHalf[1]}};
  }
  return parts;
}

}  // namespace

PiperModel::PiperModel(Zero zero, const WorkspaceOptions& workspace)
    : zero_(zero),
      table_z_(workspace.table_z),
      margin_(workspace.margin),
      lower_(workspace.lower[0], workspace.lower[1], workspace.lower[2]),
      upper_(workspace.upper[0], workspace.upper[1], workspace.upper[2]) {}

ArmVector PiperModel::Torque(const ArmVector& position, const ArmVector& velocity,
                             const ArmVector& acceleration, double payload_kg) const {
  const auto poses = LinkPoses(Joints(position), zero_);
  std::array<Vector3d, kJoints> force, moment;  // on a link, about its frame's origin
  Vector3d w = Vector3d::Zero(), dw = Vector3d::Zero(), origin = Vector3d::Zero();
  Vector3d dv(0, 0, kGravity);  // the base falls upwards: gravity
  for (int i = 0; i < kJoints; ++i) {
    const Matrix3d R = poses[i].linear();
    const Vector3d axis = R.col(2), r = poses[i].translation() - origin;
    dv += dw.cross(r) + w.cross(w.cross(r));
    dw += axis * acceleration[i] + w.cross(axis * velocity[i]);
    w += axis * velocity[i];
    origin = poses[i].translation();
    force[i].setZero();
    moment[i].setZero();
    const auto add = [&](double mass, const Vector3d& centre, const Matrix3d& inertia) {
      const Vector3d c = R * centre;
      const Matrix3d I = R * inertia * R.transpose();
      const Vector3d f = mass * (dv + dw.cross(c) + w.cross(w.cross(c)));
      force[i] += f;
      moment[i] += c.cross(f) + I * dw + w.cross(I * w);
    };
    const RigidPart& link = LinkParts()[i];
    add(link.mass, link.centre, link.inertia);
    if (i + 1 < kJoints) continue;
    add(GripperPart().mass, GripperPart().centre, GripperPart().inertia);
    const Vector3d half(kPadHalf[0], kPadHalf[1], kPadHalf[2]);
    const Matrix3d pad =
        (kPadMass / 3 * (half.squaredNorm() - half.array().square())).matrix().asDiagonal();
    const double y = kPadHalf[1] + 0.5 * std::max(0.0, position[kJoints]);
    add(kPadMass, {0, -y, kPadHeight}, pad);
    add(kPadMass, {0, y, kPadHeight}, pad);
    add(payload_kg, {0, 0, kGripHeight}, Matrix3d::Zero());
  }
  ArmVector torque{};
  Vector3d f = Vector3d::Zero(), n = Vector3d::Zero();
  for (int i = kJoints - 1; i >= 0; --i) {
    if (i + 1 < kJoints) n += (poses[i + 1].translation() - poses[i].translation()).cross(f);
    f += force[i];
    n += moment[i];
    torque[i] = poses[i].linear().col(2).dot(n) + kArmature * acceleration[i];
  }
  return torque;
}

ArmModel::Clearance PiperModel::ClearanceAt(const ArmVector& position) const {
  const auto poses = LinkPoses(Joints(position), zero_);
  Clearance clearance;
  clearance.fill(std::numeric_limits<double>::infinity());
  const auto along = Place(kAlong, poses, position[kJoints]);
  for (size_t i = 0; i < along.size(); ++i) {
    for (size_t j = 0; j < i; ++j) {
      if (along[i].link - along[j].link < 3) continue;
      clearance[kItself] =
          std::min(clearance[kItself], Distance(along[i].capsule, along[j].capsule) - margin_);
    }
  }
  for (const auto& [link, part] : Place(kAround, poses, position[kJoints])) {
    for (const Vector3d& p : {part.from, part.to}) {
      clearance[kTable] = std::min(clearance[kTable], p.z() - part.radius - table_z_ - margin_);
      for (int axis = 0; axis < 3; ++axis) {
        double &below = clearance[kBox + axis], &above = clearance[kBox + 3 + axis];
        below = std::min(below, p[axis] - lower_[axis] - part.radius - margin_);
        above = std::min(above, upper_[axis] - p[axis] - part.radius - margin_);
      }
    }
  }
  return clearance;
}

}  // namespace robostress::piper
