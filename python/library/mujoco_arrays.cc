#include "python/library/mujoco_arrays.h"

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "common/status_macros.h"
#include "python/library/boundary.h"

namespace robostress {
namespace {

using MappedVector = Eigen::Map<const Eigen::Vector3d>;

absl::Status CheckArrays(const robostress_arrays& a) {
  const struct {
    const char* name;
    const void* array;
  } needed[] = {{"arrays.qpos", a.qpos},
                {"arrays.qvel", a.qvel},
                {"arrays.ctrl", a.ctrl},
                {"arrays.xaxis", a.xaxis},
                {"arrays.xanchor", a.xanchor},
                {"arrays.subtree_com", a.subtree_com},
                {"arrays.subtree_mass", a.subtree_mass},
                {"arrays.qpos_index", a.qpos_index},
                {"arrays.dof_index", a.dof_index},
                {"arrays.ctrl_index", a.ctrl_index},
                {"arrays.joint_index", a.joint_index},
                {"arrays.body_index", a.body_index}};
  for (const auto& [name, array] : needed) RS_RETURN_IF_ERROR(CheckHandle(name, array));
  return absl::OkStatus();
}

// How a point of the joint's bodies moves with it [m/rad, or m/m].
Eigen::Vector3d Column(const robostress_arrays& a, int joint, const Eigen::Vector3d& point) {
  const int index = 3 * a.joint_index[joint];
  const MappedVector axis(a.xaxis + index), anchor(a.xanchor + index);
  if (a.slides != nullptr && a.slides[joint] != 0) return axis;
  return axis.cross(point - anchor);
}

double Holding(const robostress_arrays& a, const Eigen::Vector3d& field, int joint) {
  const int body = a.body_index[joint];
  return -a.subtree_mass[body] *
         Column(a, joint, MappedVector(a.subtree_com + 3 * body)).dot(field);
}

}  // namespace

absl::Status ReadArrays(const robostress_arrays* given, robostress_arrays& arrays) {
  RS_RETURN_IF_ERROR(ReadStructure("arrays", given, arrays));
  return CheckArrays(arrays);
}

void HoldAgainstGravity(const robostress_arrays& a, int joints, double* torque) {
  const MappedVector field(a.field);
  for (int i = 0; i < joints; ++i) torque[i] = Holding(a, field, i);
}

void TiltGravity(const robostress_arrays& a, int joints, double* change) {
  for (int axis = 0; axis < 2; ++axis) {
    const Eigen::Vector3d turned = -Eigen::Vector3d::Unit(axis).cross(MappedVector(a.field));
    for (int i = 0; i < joints; ++i) change[2 * i + axis] = Holding(a, turned, i);
  }
}

void PayloadAtTool(const robostress_arrays& a, int joints, double* gravity, double* inertia) {
  const MappedVector tool(a.tool), field(a.field);
  for (int i = 0; i < joints; ++i) {
    const Eigen::Vector3d column = Column(a, i, tool);
    gravity[i] = -column.dot(field);
    inertia[i] = column.squaredNorm();
  }
}

}  // namespace robostress
