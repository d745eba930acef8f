#include "robot_client/bridge/chain_model.h"

#include <algorithm>
#include <limits>
#include <utility>

#include "common/check.h"

namespace robostress::bridge {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr double kGravity = 9.81;         // [m/s^2]
constexpr size_t kFirstThatMayTouch = 1;  // the first link turns above its mounting

}  // namespace

ChainModel::ChainModel(ArmChain chain, const WorkspaceOptions& workspace)
    : chain_(std::move(chain)),
      table_z_(workspace.table_z),
      margin_(workspace.margin),
      lower_(workspace.lower[0], workspace.lower[1], workspace.lower[2]),
      upper_(workspace.upper[0], workspace.upper[1], workspace.upper[2]) {
  RS_CHECK(chain_.links.size() <= kMostJoints);
}

void ChainModel::Place(const ArmVector& position, Poses& poses) const {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  for (size_t i = 0; i < chain_.links.size(); ++i) {
    const ChainLink& link = chain_.links[i];
    T = T * link.T_before_joint * Eigen::AngleAxisd(position[i], link.axis);
    poses[i] = T;
  }
}

ArmVector ChainModel::Torque(const ArmVector& position, const ArmVector& velocity,
                             const ArmVector& acceleration, double payload_kg) const {
  Poses poses;
  Place(position, poses);
  const size_t n = chain_.links.size();
  std::array<Vector3d, kMostJoints> force, moment;  // on a link, about its frame's origin
  std::array<Vector3d, kMostJoints> axes;           // in the base frame
  Vector3d w = Vector3d::Zero(), dw = Vector3d::Zero(), origin = Vector3d::Zero();
  Vector3d dv(0, 0, kGravity);  // the base falls upwards: gravity
  for (size_t i = 0; i < n; ++i) {
    const ChainLink& link = chain_.links[i];
    const Matrix3d R = poses[i].linear();
    const Vector3d axis = axes[i] = R * link.axis;
    const Vector3d r = poses[i].translation() - origin;
    dv += dw.cross(r) + w.cross(w.cross(r));
    dw += axis * acceleration[i] + w.cross(axis * velocity[i]);
    w += axis * velocity[i];
    origin = poses[i].translation();
    const auto inertial = [&](double mass, const Vector3d& c) -> Vector3d {
      return mass * (dv + dw.cross(c) + w.cross(w.cross(c)));
    };
    const Vector3d c = R * link.centre;
    const Matrix3d I = R * link.inertia * R.transpose();
    force[i] = inertial(link.mass, c);
    moment[i] = c.cross(force[i]) + I * dw + w.cross(I * w);
    if (i + 1 < n) continue;
    const Vector3d tool = R * chain_.tool;
    const Vector3d carried = inertial(payload_kg, tool);
    force[i] += carried;
    moment[i] += tool.cross(carried);
  }
  ArmVector torque{};
  Vector3d f = Vector3d::Zero(), m = Vector3d::Zero();
  for (size_t i = n; i-- > 0;) {
    if (i + 1 < n) m += (poses[i + 1].translation() - poses[i].translation()).cross(f);
    f += force[i];
    m += moment[i];
    torque[i] = axes[i].dot(m);
  }
  return torque;
}

ArmModel::Clearance ChainModel::ClearanceAt(const ArmVector& position) const {
  Poses poses;
  Place(position, poses);
  Clearance clearance;
  clearance.fill(std::numeric_limits<double>::infinity());
  for (size_t i = kFirstThatMayTouch; i < chain_.links.size(); ++i) {
    for (const Ball& ball : chain_.links[i].shape) {
      const Vector3d p = poses[i] * ball.centre;
      const double inside = std::min((p - lower_).minCoeff(), (upper_ - p).minCoeff());
      clearance[kTable] = std::min(clearance[kTable], p.z() - ball.radius - table_z_ - margin_);
      clearance[kBox] = std::min(clearance[kBox], inside - ball.radius - margin_);
    }
  }
  return clearance;
}

Vector3d ChainModel::ToolAt(const ArmVector& position) const {
  Poses poses;
  Place(position, poses);
  return poses[chain_.links.size() - 1] * chain_.tool;
}

}  // namespace robostress::bridge
