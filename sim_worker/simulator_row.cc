#include "sim_worker/simulator_row.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>

#include "common/status_macros.h"
#include "sim_worker/panda_model.h"

namespace robostress {
namespace {

// Axis-angle of a unit quaternion w x y z, the angle in [0, 2 pi) as robosuite's quat2axisangle.
Eigen::Vector3d AxisAngle(const mjtNum* q) {
  const double sine = std::sqrt(std::max(0.0, 1.0 - q[0] * q[0]));
  if (sine < 1e-12) return Eigen::Vector3d::Zero();
  return Eigen::Vector3d(q[1], q[2], q[3]) * (2.0 * std::acos(std::clamp(q[0], -1.0, 1.0)) / sine);
}

}  // namespace

absl::StatusOr<SimulatorRow> ReadSimulator(const PandaSim& sim) {
  const mjModel& model = sim.model();
  const mjData& data = sim.observed();
  RS_ASSIGN_OR_RETURN(const PandaModel panda, PandaModel::Find(model));
  SimulatorRow row;
  row.state.push_back(data.time);
  row.state.insert(row.state.end(), data.qpos, data.qpos + model.nq);
  row.state.insert(row.state.end(), data.qvel, data.qvel + model.nv);
  for (int i = 0; i < 7; ++i) row.joints[i] = data.qpos[panda.qpos[i]];
  for (int i = 0; i < 2; ++i) row.fingers[i] = data.qpos[panda.finger_qpos[i]];
  const mjtNum* q = data.xquat + 4 * panda.hand_body;
  const Eigen::Vector3d rotation = AxisAngle(q);
  for (int i = 0; i < 3; ++i) {
    row.ee_pos[i] = data.site_xpos[3 * panda.grip_site + i];
    row.ee_ori[i] = rotation[i];
    row.ee_quat[i] = q[1 + i];
  }
  row.ee_quat[3] = q[0];
  return row;
}

}  // namespace robostress
