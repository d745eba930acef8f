#include "sim_worker/libero/demonstration_replay.h"

#include <map>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "sim_worker/libero/model_arrays.h"
#include "sim_worker/osc_controller.h"
#include "sim_worker/panda_model.h"

namespace robostress::libero {
namespace {

constexpr int kSubSteps = 25;
constexpr int kRecordedSubSteps = 10;  // control steps whose sub-steps are recorded

// Named columns that grow by one row per control step.
class Trajectory {
 public:
  void Append(const std::string& name, const double* values, int width) {
    Column& column = columns_[name];
    column.width = width;
    column.values.insert(column.values.end(), values, values + width);
  }
  void Append(const std::string& name, double value) { Append(name, &value, 1); }

  void AddTo(SafetensorsWriter& out) const {
    for (const auto& [name, column] : columns_) {
      std::vector<int64_t> shape = {static_cast<int64_t>(column.values.size()) / column.width};
      if (column.width > 1) shape.push_back(column.width);
      out.AddDoubles(name, shape, column.values);
    }
  }

 private:
  struct Column {
    int width = 1;
    std::vector<double> values;
  };
  std::map<std::string, Column> columns_;
};

using RowMajor3 = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;

void AppendRow(const LiberoSimTask& task, const PandaSim& sim, const PandaModel& panda,
               Trajectory& trajectory) {
  const mjModel& m = sim.model();
  const mjData& d = sim.data();
  const mjData& seen = sim.observed();
  trajectory.Append("time", d.time);
  trajectory.Append("qpos", d.qpos, m.nq);
  trajectory.Append("qvel", d.qvel, m.nv);
  trajectory.Append("ctrl", d.ctrl, m.nu);
  double torque[7];
  for (int i = 0; i < 7; ++i) torque[i] = d.ctrl[panda.motor[i]];
  trajectory.Append("torque", torque, 7);
  trajectory.Append("ncon", d.ncon);
  trajectory.Append("success", task.Success());
  trajectory.Append("reward", task.Success());
  trajectory.Append("eef_pos", seen.site_xpos + 3 * panda.grip_site, 3);
  const double* wxyz = seen.xquat + 4 * panda.hand_body;
  const double xyzw[4] = {wxyz[1], wxyz[2], wxyz[3], wxyz[0]};
  trajectory.Append("eef_quat", xyzw, 4);
  const double fingers[2] = {seen.qpos[panda.finger_qpos[0]], seen.qpos[panda.finger_qpos[1]]};
  trajectory.Append("gripper_qpos", fingers, 2);
  trajectory.Append("goal_pos", sim.controller().goal_position().data(), 3);
  const RowMajor3 goal = sim.controller().goal_rotation();
  trajectory.Append("goal_ori", goal.data(), 9);
}

void AddModel(const mjModel& model, SafetensorsWriter& out) {
  for (const ModelArray& array : ModelArrays(model)) {
    size_t size = DTypeSize(array.dtype);
    for (const int64_t n : array.shape) size *= n;
    out.Add("model." + array.name, array.dtype, array.shape, array.data, size);
  }
  out.AddDoubles("body_pos", {model.nbody, 3},
                 {model.body_pos, 3 * static_cast<size_t>(model.nbody)});
  out.AddDoubles("body_quat", {model.nbody, 4},
                 {model.body_quat, 4 * static_cast<size_t>(model.nbody)});
}

void AddInputs(const Recording& recording, SafetensorsWriter& out) {
  out.AddDoubles("actions", {recording.steps(), 7}, recording.actions);
  out.AddDoubles("init_state", {static_cast<int64_t>(recording.init_state.size())},
                 recording.init_state);
  out.AddDoubles("reset_qpos", {static_cast<int64_t>(recording.reset_qpos.size())},
                 recording.reset_qpos);
  out.AddDoubles("initial_joint", {7}, {recording.home.data(), 7});
}

}  // namespace

absl::StatusOr<Recording> ReadRecording(const SafetensorsFile& file, const LiberoSimTask& task) {
  const mjModel& m = *task.scene().model;
  RS_ASSIGN_OR_RETURN(const PandaModel panda, PandaModel::Find(m));
  Recording recording;
  RS_ASSIGN_OR_RETURN(recording.actions, file.ReadDoubles("actions", {-1, 7}));
  if (recording.actions.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(file.path(), ": tensor 'actions' has no rows"));
  }
  RS_ASSIGN_OR_RETURN(recording.init_state, file.ReadDoubles("init_state", {1 + m.nq + m.nv}));
  RS_ASSIGN_OR_RETURN(recording.reset_qpos, file.ReadDoubles("reset_qpos", {m.nq}));
  for (int i = 0; i < 7; ++i) recording.home[i] = recording.reset_qpos[panda.qpos[i]];
  if (!file.tensors().contains("body_pos") && !file.tensors().contains("body_quat"))
    return recording;
  RS_ASSIGN_OR_RETURN(const std::vector<double> pos, file.ReadDoubles("body_pos", {m.nbody, 3}));
  RS_ASSIGN_OR_RETURN(const std::vector<double> quat, file.ReadDoubles("body_quat", {m.nbody, 4}));
  for (const FixturePose& fixture : task.scene().centred_fixtures) {
    const int body = task.scene().objects.at(fixture.fixture).body;
    FixturePose pose{fixture.fixture, {}, {}};
    std::copy_n(pos.begin() + 3 * body, 3, pose.pos.begin());
    std::copy_n(quat.begin() + 4 * body, 4, pose.quat.begin());
    recording.fixtures.push_back(pose);
  }
  return recording;
}

absl::Status Replay(const Recording& recording, int settle_steps, LiberoSimTask& task,
                    SafetensorsWriter& out) {
  if (!recording.fixtures.empty()) RS_RETURN_IF_ERROR(task.MoveFixtures(recording.fixtures));
  PandaSim& sim = task.sim();
  const mjModel& m = sim.model();
  RS_ASSIGN_OR_RETURN(const PandaModel panda, PandaModel::Find(m));
  const absl::Span<const double> state = recording.init_state;
  RS_RETURN_IF_ERROR(
      task.ResetTo(state.subspan(1, m.nq), state.subspan(1 + m.nq, m.nv), recording.home));
  AddInputs(recording, out);
  AddModel(task.placed_model(), out);
  out.AddDoubles("goal_pos0", {3}, {sim.controller().goal_position().data(), 3});
  const RowMajor3 goal = sim.controller().goal_rotation();
  out.AddDoubles("goal_ori0", {3, 3}, {goal.data(), 9});

  Trajectory trajectory;
  AppendRow(task, sim, panda, trajectory);
  std::vector<double> sub_steps;
  const int recorded = std::min(recording.steps(), kRecordedSubSteps);
  sim.OnSubStep([&] {
    if (static_cast<int>(sub_steps.size()) < recorded * kSubSteps * m.nu)
      sub_steps.insert(sub_steps.end(), sim.data().ctrl, sim.data().ctrl + m.nu);
  });
  for (int t = 0; t < recording.steps(); ++t) {
    const Eigen::Map<const Eigen::Matrix<double, 7, 1>> command(recording.actions.data() + 7 * t);
    const absl::Status stepped = task.StepExact(command, t < settle_steps);
    if (!stepped.ok()) {
      sim.OnSubStep(nullptr);
      return absl::Status(stepped.code(), absl::StrCat("action ", t, ": ", stepped.message()));
    }
    AppendRow(task, sim, panda, trajectory);
  }
  sim.OnSubStep(nullptr);
  trajectory.AddTo(out);
  out.AddDoubles("sub_torque_first10", {recorded, kSubSteps, m.nu}, sub_steps);
  return absl::OkStatus();
}

}  // namespace robostress::libero
