#include "sim_worker/record/libero_recorder.h"

#include <Eigen/Geometry>
#include <cmath>

#include "common/check.h"
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

template <class Range>
void Append(std::vector<double>& column, const Range& values) {
  column.insert(column.end(), values.begin(), values.end());
}

}  // namespace

absl::StatusOr<SimulatorRow> ReadSimulator(EmbeddedTask& task) {
  const PandaSim& sim = task.sim();
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

LiberoDemonstration ToLibero(const Demonstration& demonstration, const std::string& model_file) {
  LiberoDemonstration result;
  result.model_file = model_file;
  LiberoColumns& columns = result.columns;
  columns.steps = static_cast<int64_t>(demonstration.frames.size());
  for (const DemonstrationFrame& frame : demonstration.frames) {
    RS_CHECK(frame.simulator.has_value() && frame.views.size() == 2 && frame.actions.cols() == 7);
    const SimulatorRow& row = *frame.simulator;
    for (int i = 0; i < 7; ++i) columns.actions.push_back(frame.actions(0, i));
    Append(columns.states, row.state);
    Append(columns.robot_states, row.fingers);
    Append(columns.robot_states, row.ee_pos);
    Append(columns.robot_states, row.ee_quat);
    Append(columns.ee_pos, row.ee_pos);
    Append(columns.ee_ori, row.ee_ori);
    Append(columns.gripper_states, row.fingers);
    Append(columns.joint_states, row.joints);
    for (int i = 0; i < 8; ++i) {
      columns.proprioception.push_back(frame.proprioception[i]);
      columns.aux.push_back(frame.aux[i]);
    }
    result.agentview.push_back(frame.views[0]);
    result.eye_in_hand.push_back(frame.views[1]);
  }
  return result;
}

}  // namespace robostress
