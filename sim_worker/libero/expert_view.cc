#include "sim_worker/libero/expert_view.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>

#include "absl/strings/match.h"

namespace robostress::libero {

using Eigen::Matrix3d;
using Eigen::Quaterniond;
using Eigen::Vector3d;

namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();
constexpr double kWayStep = 0.01;   // [m] between the points of a way that are looked at
constexpr double kParallel = 1e-6;  // the cross product of directions that count as one

Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> Frame(const double* values) {
  return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(values);
}

}  // namespace

ExpertView::ExpertView(const LiberoSimTask& task)
    : task_(task),
      model_(const_cast<LiberoSimTask&>(task).sim().model()),
      data_(std::as_const(const_cast<LiberoSimTask&>(task).sim()).data()),
      panda_(PandaModel::Find(model_).value()) {
  for (const int side : {0, 1})
    fingers_[side] = model_.jnt_bodyid[model_.dof_jntid[panda_.finger_dof[side]]];
  std::vector<char> placed(model_.nbody, 0);  // an object, a fixture or a part of one
  for (const auto& [name, object] : task.scene().objects) placed[object.body] = 1;
  for (int body = 1; body < model_.nbody; ++body)
    placed[body] |= placed[model_.body_parentid[body]];
  for (int geom = 0; geom < model_.ngeom; ++geom) {
    const bool collides = model_.geom_contype[geom] != 0 || model_.geom_conaffinity[geom] != 0;
    if (collides && placed[model_.geom_bodyid[geom]] != 0) obstacles_.push_back(geom);
  }
}

Vector3d ExpertView::Tool() const {
  return Eigen::Map<const Vector3d>(data_.site_xpos + 3 * panda_.grip_site);
}

Quaterniond ExpertView::Hand() const { return BodyQuat(panda_.hand_body); }

double ExpertView::Yaw() const {
  // Fingers open along the hand's y axis.
  const Vector3d opening = Hand() * Vector3d::UnitY();
  return std::remainder(std::atan2(opening.x(), -opening.y()), M_PI);
}

double ExpertView::Gap() const {
  return data_.qpos[panda_.finger_qpos[0]] - data_.qpos[panda_.finger_qpos[1]];
}

Vector3d ExpertView::Base() const { return Body(panda_.base_body); }

Vector3d ExpertView::Body(int body) const {
  return Eigen::Map<const Vector3d>(data_.xpos + 3 * body);
}

Quaterniond ExpertView::BodyQuat(int body) const {
  const double* q = data_.xquat + 4 * body;
  return Quaterniond(q[0], q[1], q[2], q[3]);
}

Vector3d ExpertView::Site(int site) const {
  return Eigen::Map<const Vector3d>(data_.site_xpos + 3 * site);
}

Matrix3d ExpertView::SiteFrame(int site) const { return Frame(data_.site_xmat + 9 * site); }

Vector3d ExpertView::Geom(int geom) const {
  return Eigen::Map<const Vector3d>(data_.geom_xpos + 3 * geom);
}

double ExpertView::Joint(int joint) const { return data_.qpos[model_.jnt_qposadr[joint]]; }

Vector3d ExpertView::JointAxis(int joint) const {
  return Eigen::Map<const Vector3d>(data_.xaxis + 3 * joint).normalized();
}

Vector3d ExpertView::JointAnchor(int joint) const {
  return Eigen::Map<const Vector3d>(data_.xanchor + 3 * joint);
}

std::array<bool, 2> ExpertView::Touches(int body) const {
  std::array<bool, 2> touches = {false, false};
  for (int i = 0; i < data_.ncon; ++i) {
    const int bodies[2] = {model_.geom_bodyid[data_.contact[i].geom1],
                           model_.geom_bodyid[data_.contact[i].geom2]};
    for (const int k : {0, 1}) {
      if (model_.body_rootid[bodies[1 - k]] != model_.body_rootid[body]) continue;
      for (const int finger : {0, 1}) {
        for (int part = bodies[k]; part != 0; part = model_.body_parentid[part])
          touches[finger] = touches[finger] || part == fingers_[finger];
      }
    }
  }
  return touches;
}

bool ExpertView::Holds(int body) const {
  const std::array<bool, 2> touches = Touches(body);
  return touches[0] && touches[1];
}

Vector3d ExpertView::TouchingFinger(int body) const {
  const std::array<bool, 2> touches = Touches(body);
  if (touches[0] == touches[1]) return Vector3d::Zero();
  // A finger's own frame moves out along the hand's y axis.
  const Vector3d out =
      Body(fingers_[touches[0] ? 0 : 1]) - (Body(fingers_[0]) + Body(fingers_[1])) / 2;
  return Vector3d(out.x(), out.y(), 0);
}

bool ExpertView::Stands(int body) const {
  const int root = model_.body_rootid[body], robot = model_.body_rootid[panda_.hand_body];
  for (int i = 0; i < data_.ncon; ++i) {
    const int a = model_.body_rootid[model_.geom_bodyid[data_.contact[i].geom1]];
    const int b = model_.body_rootid[model_.geom_bodyid[data_.contact[i].geom2]];
    if ((a == root) != (b == root) && a != robot && b != robot) return true;
  }
  return false;
}

std::vector<int> ExpertView::Geoms(int body) const {
  std::vector<int> geoms;
  for (int geom = 0; geom < model_.ngeom; ++geom) {
    if (model_.geom_group[geom] != 0) continue;
    int above = model_.geom_bodyid[geom];
    while (above != body && above != 0) above = model_.body_parentid[above];
    if (above == body) geoms.push_back(geom);
  }
  return geoms;
}

double ExpertView::Support(int geom, const Vector3d& direction) const {
  const double* size = model_.geom_size + 3 * geom;
  const Vector3d along = Frame(data_.geom_xmat + 9 * geom).transpose() * direction;
  switch (model_.geom_type[geom]) {
    case mjGEOM_SPHERE:
      return size[0];
    case mjGEOM_CAPSULE:
      return size[0] + std::abs(along.z()) * size[1];
    case mjGEOM_CYLINDER:
      return size[0] * along.head<2>().norm() + size[1] * std::abs(along.z());
    default:
      return std::abs(along.x()) * size[0] + std::abs(along.y()) * size[1] +
             std::abs(along.z()) * size[2];
  }
}

Extent ExpertView::ExtentOf(int geom) const {
  const Vector3d half(Support(geom, Vector3d::UnitX()), Support(geom, Vector3d::UnitY()),
                      Support(geom, Vector3d::UnitZ()));
  return {Geom(geom) - half, Geom(geom) + half};
}

Extent ExpertView::ExtentOf(const std::vector<int>& geoms) const {
  Extent extent{Vector3d::Constant(kInfinity), Vector3d::Constant(-kInfinity)};
  for (const int geom : geoms) {
    const Extent one = ExtentOf(geom);
    extent.low = extent.low.cwiseMin(one.low);
    extent.high = extent.high.cwiseMax(one.high);
  }
  return extent;
}

bool ExpertView::IsObstacle(int geom, int except) const {
  for (int body = model_.geom_bodyid[geom]; body != 0; body = model_.body_parentid[body]) {
    if (body == except) return false;
  }
  return true;
}

double ExpertView::TopAlong(const Vector3d& from, const Vector3d& to, double radius, double ahead,
                            int except) const {
  const Eigen::Vector2d way = (to - from).head<2>();
  const double length = std::min(way.norm(), ahead);
  const Eigen::Vector2d direction = way.norm() > 1e-9 ? Eigen::Vector2d(way.normalized()) : way;
  double top = -kInfinity;
  for (const int geom : obstacles_) {
    if (!IsObstacle(geom, except)) continue;
    const Extent extent = ExtentOf(geom);
    if (extent.high.z() <= top) continue;
    for (double done = 0; done <= length + 1e-9; done += kWayStep) {
      const Eigen::Vector2d point = from.head<2>() + done * direction;
      const Eigen::Vector2d outside =
          (extent.low.head<2>() - point).cwiseMax(point - extent.high.head<2>()).cwiseMax(0);
      if (outside.norm() < radius) {
        top = extent.high.z();
        break;
      }
    }
  }
  return top;
}

bool ExpertView::Overlaps(int geom, const Vector3d& centre, const Vector3d& half) const {
  const Vector3d apart = Geom(geom) - centre;
  const auto separated = [&](const Vector3d& axis) {
    return std::abs(apart.dot(axis)) >= half.dot(axis.cwiseAbs()) + Support(geom, axis);
  };
  const Matrix3d frame = Frame(data_.geom_xmat + 9 * geom);
  for (int i = 0; i < 3; ++i) {
    if (separated(Vector3d::Unit(i)) || separated(frame.col(i))) return false;
  }
  for (int i = 0; i < 3; ++i) {
    for (int k = 0; k < 3; ++k) {
      const Vector3d axis = Vector3d::Unit(i).cross(frame.col(k));
      if (axis.norm() > kParallel && separated(axis.normalized())) return false;
    }
  }
  return true;
}

bool ExpertView::Blocked(const Vector3d& centre, const Vector3d& half, int except) const {
  return std::any_of(obstacles_.begin(), obstacles_.end(), [&](int geom) {
    return IsObstacle(geom, except) && Overlaps(geom, centre, half);
  });
}

}  // namespace robostress::libero
