#include "sim_worker/suites/embedded_task.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "common/image.h"
#include "common/joint_errors/scenarios.h"
#include "common/so3.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/suites/goals.h"

namespace robostress {
namespace {

constexpr int kSupersampleUpTo = 112;  // [px]

std::string KnownSuites() { return absl::StrJoin(SuitesOf("panda"), ", "); }

}  // namespace

std::string TaskName(const std::string& instruction) {
  return absl::StrReplaceAll(instruction, {{" ", "_"}});
}

absl::StatusOr<std::unique_ptr<EmbeddedTask>> EmbeddedTask::Create(const UnitConfig& unit,
                                                                   int task) {
  const SuiteSpec* suite = FindSuiteSpec(unit.suite);
  const SuiteInfo* info = FindSuite(unit.suite);
  if (suite == nullptr || info == nullptr) {
    return absl::NotFoundError(
        absl::StrCat("suite '", unit.suite, "' is unknown; known suites: ", KnownSuites()));
  }
  const int num_tasks = static_cast<int>(suite->tasks.size());
  if (task < 0 || task >= num_tasks) {
    return absl::OutOfRangeError(absl::StrCat("task ", task, " of suite '", unit.suite,
                                              "' does not exist; tasks are 0 to ", num_tasks - 1,
                                              " (robostress suites lists them)"));
  }
  RS_ASSIGN_OR_RETURN(const Scenario scenario, MakeScenario(unit.scenario, unit.severity));
  std::unique_ptr<EmbeddedTask> result(new EmbeddedTask());
  result->horizon_ = HorizonOf(unit);
  result->settle_steps_ = unit.sim.settle_steps;
  result->name_ = TaskName(suite->tasks[task].instruction);
  RS_ASSIGN_OR_RETURN(result->model_, TaskModel::Create(*suite, task));
  RS_ASSIGN_OR_RETURN(result->sim_, PandaSim::Create(result->model_->model(), unit.sim));
  result->sim_->SetScenario(scenario, result->horizon_);
  return result;
}

absl::Status EmbeddedTask::Reset(int initial_state) {
  const int num_states = FindSuite(model_->suite().name)->num_initial_states;
  if (initial_state < 0 || (initial_state >= num_states && initial_state < kFirstTrainingDraw)) {
    return absl::OutOfRangeError(absl::StrCat(
        "initial state ", initial_state, " does not exist; 0 to ", num_states - 1,
        " are reproducible states, ", kFirstTrainingDraw, " and above are training draws"));
  }
  return ResetTo(SampleInitialState(model_->suite(), model_->task_index(), initial_state));
}

absl::Status EmbeddedTask::ResetTo(const InitialState& state) {
  RS_RETURN_IF_ERROR(sim_->Reset(model_->Qpos(state), EmbeddedHome()));
  model_->PlaceStaticProps(state, sim_->mutable_data());
  mj_forward(&sim_->model(), &sim_->mutable_data());
  return sim_->Settle(settle_steps_);
}

Eigen::VectorXf EmbeddedTask::Proprioception() const {
  static const Eigen::Quaterniond kHome(0, 1, 0, 0);  // straight down: diag(1, -1, -1)
  const RobotState state = sim_->Measure();
  const Eigen::Vector3d rotation = RotationBetween(kHome, state.tool.q_base_tool);
  Eigen::VectorXf result(8);
  for (int i = 0; i < 3; ++i) {
    result[i] = static_cast<float>(state.tool.p_base_tool[i]);
    result[3 + i] = static_cast<float>(rotation[i]);
  }
  for (int i = 0; i < 2; ++i) result[6 + i] = static_cast<float>(sim_->observed().qpos[7 + i]);
  return result;
}

absl::StatusOr<Image> EmbeddedTask::RenderView(const std::string& camera, int width, int height) {
  if (renderer_ == nullptr) {
    RS_ASSIGN_OR_RETURN(renderer_, Renderer::Create(model_->model()));
  }
  RenderOptions options;
  options.width = width;
  options.height = height;
  options.supersample = std::max(width, height) <= kSupersampleUpTo ? 2 : 1;
  return renderer_->Render(sim_->observed(), camera, options);
}

absl::StatusOr<Observation> EmbeddedTask::Observe(const PolicySpec& spec) {
  Observation observation;
  observation.instruction = instruction();
  observation.proprioception = Proprioception();
  for (const std::string& camera : spec.cameras) {
    if (camera != kAgentView && camera != kWristView) {
      return absl::NotFoundError(absl::StrCat("camera '", camera, "' is unknown; cameras are ",
                                              kAgentView, ", ", kWristView));
    }
    RS_ASSIGN_OR_RETURN(Image image, RenderView(camera, spec.image_width, spec.image_height));
    observation.views.push_back({camera, std::move(image)});
  }
  return observation;
}

bool EmbeddedTask::Success() const { return TaskSucceeds(*model_, *sim_); }

absl::StatusOr<Expert> EmbeddedTask::MakeExpert() {
  return [this] { return Decide(); };
}

absl::StatusOr<Image> EmbeddedTask::Film(int height) {
  RS_ASSIGN_OR_RETURN(const Image agent, RenderView(kAgentView, height, height));
  RS_ASSIGN_OR_RETURN(const Image wrist, RenderView(kWristView, height, height));
  return HStack({agent, wrist}, 2);
}

}  // namespace robostress
