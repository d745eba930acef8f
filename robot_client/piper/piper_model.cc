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
constexpr LinkCapsule kCapsules[] = {
    {0, {0, 0, 0}, {0, 0, 0.07}, 0.06},
    {1, {0, 0, -0.05}, {0, 0, 0.01}, 0.045},
    {2, {0.02, 0, 0}, {0.27, 0, 0}, 0.035},
    {3, {0, -0.02, 0}, {-0.022, -0.19, 0}, 0.032},
    {4, {0, 0, -0.05}, {0, 0, 0.01}, 0.03},
    {5, {0, -0.01, 0}, {0, -0.06, 0}, 0.028},
    {6, {0, -0.02, 0.035}, {0, 0.02, 0.035}, 0.042},
};
constexpr double kPadRadius = 0.0134;  // of the capsules of the two pads [m]
constexpr int kParts = static_cast<int>(std::size(kCapsules)) + 4;

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

std::array<Placed, kParts> Place(const JointVector& q, double opening, Zero zero) {
  const auto T_base_link = LinkPoses(q, zero);
  const auto in_base = [&](int link, const Vector3d& p) -> Vector3d {
    return link == 0 ? p : Vector3d(T_base_link[link - 1] * p);
  };
  std::array<Placed, kParts> parts;
  int n = 0;
  for (const LinkCapsule& c : kCapsules)
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
  const auto parts = Place(Joints(position), position[kJoints], zero_);
  Clearance clearance;
  clearance.fill(std::numeric_limits<double>::infinity());
  for (int i = 0; i < kParts; ++i) {
    const auto& [link, a] = parts[i];
    for (int j = 0; j < i; ++j) {
      if (link - parts[j].link < 3) continue;
      clearance[kItself] = std::min(clearance[kItself], Distance(a, parts[j].capsule) - margin_);
    }
    if (link < 2) continue;
    for (const Vector3d& p : {a.from, a.to}) {
      clearance[kTable] = std::min(clearance[kTable], p.z() - a.radius - table_z_ - margin_);
      const double inside = std::min((p - lower_).minCoeff(), (upper_ - p).minCoeff());
      clearance[kBox] = std::min(clearance[kBox], inside - a.radius - margin_);
    }
  }
  return clearance;
}

}  // namespace robostress::piper
