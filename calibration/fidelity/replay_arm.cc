#include "calibration/fidelity/replay_arm.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/so3.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/osc_controller.h"
#include "sim_worker/suites/expert.h"
#include "sim_worker/suites/goals.h"

namespace robostress::calibration {
namespace {

using Command = Eigen::Matrix<double, 7, 1>;
constexpr double kPayloadRadius = 0.03;  // of the added mass, a ball at the object's centre [m]

// `model` with more mass on one body.
absl::StatusOr<SharedModel> WithPayload(const SharedModel& model, int body, double payload_kg) {
  mjModel* heavier = mj_copyModel(nullptr, model.get());
  if (heavier == nullptr) return absl::ResourceExhaustedError("no memory for a model");
  SharedModel result(heavier, [](const mjModel* m) { mj_deleteModel(const_cast<mjModel*>(m)); });
  heavier->body_mass[body] += payload_kg;
  for (int axis = 0; axis < 3; ++axis)
    heavier->body_inertia[3 * body + axis] += 0.4 * payload_kg * kPayloadRadius * kPayloadRadius;
  mjData* data = mj_makeData(heavier);
  if (data == nullptr) return absl::ResourceExhaustedError("no memory for mjData");
  mj_setConst(heavier, data);
  mj_deleteData(data);
  return result;
}

}  // namespace

absl::StatusOr<std::unique_ptr<ReplayArm>> ReplayArm::Create(const ReplayTask& task,
                                                             double payload_kg) {
  if (!(payload_kg >= 0) || payload_kg > 100) {
    return absl::InvalidArgumentError(
        absl::StrFormat("payload %g kg: must be in [0, 100]", payload_kg));
  }
  const SuiteSpec* suite = FindSuiteSpec(task.suite);
  if (suite == nullptr) {
    return absl::NotFoundError(absl::StrCat(
        "suite '", task.suite, "' is not one of the embedded suites; see `robostress suites`"));
  }
  if (task.task < 0 || task.task >= static_cast<int>(suite->tasks.size())) {
    return absl::OutOfRangeError(absl::StrCat("task ", task.task, " of suite '", task.suite,
                                              "' does not exist; tasks are 0 to ",
                                              suite->tasks.size() - 1));
  }
  std::unique_ptr<ReplayArm> arm(new ReplayArm());
  arm->task_ = task;
  RS_ASSIGN_OR_RETURN(arm->model_, TaskModel::Create(*suite, task.task));
  const auto& goals = arm->model_->task().goals;
  if (goals.size() != 1 || goals[0].kind != GoalKind::kPlace) {
    return absl::InvalidArgumentError(
        absl::StrCat("task ", task.task, " of suite '", task.suite, "' (", arm->instruction(),
                     ") is not to pick up and place one object; choose another with --task"));
  }
  const auto& props = suite->scenes[arm->model_->task().scene].props;
  const auto object = std::find_if(props.begin(), props.end(),
                                   [&](const Prop& prop) { return prop.name == goals[0].object; });
  arm->object_ = static_cast<int>(object - props.begin());
  const int body = arm->model_->BodyId(goals[0].object);
  arm->object_mass_ = arm->model_->model()->body_mass[body];
  RS_ASSIGN_OR_RETURN(const SharedModel heavier,
                      WithPayload(arm->model_->model(), body, payload_kg));
  RS_ASSIGN_OR_RETURN(arm->sim_, PandaSim::Create(heavier, task.sim));
  SimOptions recording = task.sim;  // the expert is made for goals relative to the achieved pose
  recording.goal_reference = GoalReference::kAchieved;
  RS_ASSIGN_OR_RETURN(arm->recorder_, PandaSim::Create(arm->model_->model(), recording));
  return arm;
}

absl::StatusOr<Demonstration> ReplayArm::Record(int layout, const Scenario& scenario) {
  const SuiteInfo& suite = *FindSuite(task_.suite);
  PandaSim& sim = *recorder_;
  sim.SetScenario(scenario, suite.horizon);
  const InitialState state = SampleInitialState(model_->suite(), task_.task, layout);
  RS_RETURN_IF_ERROR(sim.Reset(model_->Qpos(state), EmbeddedHome()));
  model_->PlaceStaticProps(state, sim.mutable_data());
  mj_forward(&sim.model(), &sim.mutable_data());
  RS_RETURN_IF_ERROR(sim.Settle(task_.sim.settle_steps));
  Demonstration demonstration;
  while (!TaskSucceeds(*model_, sim)) {
    if (sim.steps_taken() == suite.horizon) {
      return absl::FailedPreconditionError(absl::StrFormat(
          "layout %d: the expert does not complete '%s' in %d steps; choose another "
          "layout or task",
          layout, instruction(), suite.horizon));
    }
    const Command command = DecideExpert(*model_, sim).command.cast<double>();
    RS_RETURN_IF_ERROR(sim.StepExact(command));
    demonstration.commands.push_back(command);
    demonstration.targets.push_back(
        {sim.controller().goal_position(), sim.controller().goal_rotation(), command[6]});
  }
  return demonstration;
}

// Achieved goals: the expert's deltas. Desired goals: the deltas that lead the controller's goal
// from where it stands now along the targets; what a clipped one leaves is made up for by the next.
std::vector<Command> ReplayArm::Commands(const Demonstration& demonstration) const {
  if (task_.sim.goal_reference == GoalReference::kAchieved) return demonstration.commands;
  Eigen::Vector3d p = sim_->controller().goal_position();
  Eigen::Matrix3d R = sim_->controller().goal_rotation();
  std::vector<Command> commands;
  for (const Demonstration::Target& target : demonstration.targets) {
    Command command;
    command.head<3>() = (target.p - p) / OscController::kPositionScale;
    command.segment<3>(3) =
        LogSo3(Eigen::Matrix3d(target.R * R.transpose())) / OscController::kRotationScale;
    command[6] = target.gripper;
    command.head<6>() = command.head<6>().cwiseMax(-1).cwiseMin(1);
    p += OscController::kPositionScale * command.head<3>();
    R = ExpSo3(OscController::kRotationScale * command.segment<3>(3)).toRotationMatrix() * R;
    commands.push_back(command);
  }
  return commands;
}

absl::StatusOr<Replay> ReplayArm::Run(int layout, const Demonstration& demonstration,
                                      const ReplayConditions& conditions) {
  PandaSim& sim = *sim_;
  sim.SetScenario(conditions.scenario, FindSuite(task_.suite)->horizon);
  InitialState state = SampleInitialState(model_->suite(), task_.task, layout);
  state.q += conditions.q_offset;
  state.positions[object_].head<2>() += conditions.object_offset;
  RS_RETURN_IF_ERROR(sim.Reset(model_->Qpos(state), EmbeddedHome()));
  model_->PlaceStaticProps(state, sim.mutable_data());
  mj_forward(&sim.model(), &sim.mutable_data());
  RS_RETURN_IF_ERROR(sim.Settle(task_.sim.settle_steps));
  RandomStream noise(conditions.noise);
  Replay replay;
  const auto look = [&] {
    const RobotState robot = sim.Measure();
    replay.t.push_back(robot.stamp_s);
    replay.p.push_back(robot.tool.p_base_tool);
    replay.held.push_back(sim.GraspDetected());
  };
  look();
  for (Command command : Commands(demonstration)) {
    for (int k = 0; k < 6; ++k) command[k] += conditions.command_sigma * noise.Normal();
    RS_RETURN_IF_ERROR(sim.StepExact(command));
    look();
  }
  return replay;
}

}  // namespace robostress::calibration
