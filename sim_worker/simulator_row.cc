#include "sim_worker/simulator_row.h"

#include "common/status_macros.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/robosuite_rotation.h"

namespace robostress {

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
  const Eigen::Vector3d rotation = AxisAngleAsRobosuite(q);
  for (int i = 0; i < 3; ++i) {
    row.ee_pos[i] = data.site_xpos[3 * panda.grip_site + i];
    row.ee_ori[i] = rotation[i];
    row.ee_quat[i] = q[1 + i];
  }
  row.ee_quat[3] = q[0];
  return row;
}

}  // namespace robostress
