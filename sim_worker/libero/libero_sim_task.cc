#include "sim_worker/libero/libero_sim_task.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <mutex>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/image.h"
#include "common/image_resize.h"
#include "common/joint_errors/scenarios.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/libero/box_contacts.h"
#include "sim_worker/libero/libero_expert.h"
#include "sim_worker/libero/libero_task.h"
#include "sim_worker/libero/preprocess.h"
#include "sim_worker/libero/task_doubts.h"
#include "sim_worker/libero/task_files.h"
#include "sim_worker/libero/thin_meshes.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/robosuite_rotation.h"

namespace robostress::libero {
namespace {

constexpr double kThinCell = 0.008;  // [m] of plain pictures' meshes; a pixel of 64 is 6 to 15 mm
constexpr int kCameraSize = 256;     // [px] of LIBERO's renderings before they are resized

void AnnounceMissingVisuals(const LiberoScene& scene) {
  if (scene.missing_visuals.empty()) return;
  static std::once_flag once;
  std::call_once(once, [&] {
    spdlog::warn(
        "{} mesh and texture files of this scene are not in the checkouts (first: {}); plain "
        "shapes "
        "of equal bounds and flat colours replace them. Dynamics stay, images are not LIBERO's.",
        scene.missing_visuals.size(), scene.missing_visuals.front());
  });
}

std::vector<FreeBody> FreeBodies(const mjModel& model) {
  std::vector<FreeBody> bodies;
  for (int joint = 0; joint < model.njnt; ++joint) {
    if (model.jnt_type[joint] != mjJNT_FREE) continue;
    const char* name = mj_id2name(&model, mjOBJ_BODY, model.jnt_bodyid[joint]);
    bodies.push_back({name == nullptr ? "" : name, model.jnt_qposadr[joint]});
  }
  return bodies;
}

std::vector<LimitedJoint> LimitedJoints(const mjModel& model) {
  std::vector<LimitedJoint> joints;
  for (int joint = 0; joint < model.njnt; ++joint) {
    const int type = model.jnt_type[joint];
    if (!model.jnt_limited[joint] || (type != mjJNT_HINGE && type != mjJNT_SLIDE)) continue;
    const char* name = mj_id2name(&model, mjOBJ_JOINT, joint);
    joints.push_back({name == nullptr ? "" : name, model.jnt_qposadr[joint],
                      model.jnt_range[2 * joint], model.jnt_range[2 * joint + 1]});
  }
  return joints;
}

// An error of a file that came with LIBERO or robosuite.
absl::Status WithRemedy(const LiberoPaths& paths, const absl::Status& status) {
  const std::string message(status.message());
  for (const std::string& folder :
       {paths.libero + "/assets/", paths.libero + "/init_files/", paths.robosuite + "/"}) {
    if (!absl::StrContains(message, folder)) continue;
    return absl::Status(status.code(),
                        absl::StrCat(message,
                                     "; unless you changed it, run `robostress libero "
                                     "setup`, which checks every file that was published"));
  }
  return status;
}

}  // namespace

Eigen::Matrix<double, 7, 1> LiberoSimTask::HomePosture() {
  return Eigen::Map<const Eigen::Matrix<double, 7, 1>>(kHomePosture.data());
}

absl::StatusOr<std::unique_ptr<LiberoSimTask>> LiberoSimTask::Create(const UnitConfig& unit,
                                                                     int task) {
  LeaveOutImpossibleBoxContacts();
  RS_ASSIGN_OR_RETURN(std::unique_ptr<LiberoSimTask> result, Read(unit, task, /*pictures=*/true));
  AnnounceMissingVisuals(*result->scene_);
  for (const std::string& doubt : DoubtsOf(result->scene_->problem)) spdlog::warn("{}", doubt);
  RS_RETURN_IF_ERROR(result->MakeSimulator());
  return result;
}

absl::Status LiberoSimTask::Check(const UnitConfig& unit, int task) {
  return Read(unit, task, /*pictures=*/false).status();
}

// All but the simulator.
absl::StatusOr<std::unique_ptr<LiberoSimTask>> LiberoSimTask::Read(const UnitConfig& unit, int task,
                                                                   bool pictures) {
  RS_ASSIGN_OR_RETURN(const Scenario scenario, MakeScenario(unit.scenario, unit.severity));
  RS_ASSIGN_OR_RETURN(const LiberoPaths paths, FindLibero(unit.libero_root, unit.robosuite_root));
  RS_ASSIGN_OR_RETURN(const TaskFiles files, FindTaskFiles(paths, unit, task));
  RS_ASSIGN_OR_RETURN(BddlProblem problem, ReadBddl(files.bddl));
  absl::StatusOr<LiberoScene> composed = ComposeScene(paths, std::move(problem), pictures);
  if (!composed.ok()) return WithRemedy(paths, composed.status());

  std::unique_ptr<LiberoSimTask> result(new LiberoSimTask());
  result->unit_ = unit;
  result->name_ = files.name;
  result->instruction_ = files.instruction;
  result->horizon_ = HorizonOf(unit);
  result->scenario_ = scenario;
  result->scene_ = std::make_unique<LiberoScene>(*std::move(composed));
  RS_ASSIGN_OR_RETURN(LiberoGoal goal, LiberoGoal::Create(*result->scene_));
  result->goal_ = std::make_unique<LiberoGoal>(std::move(goal));
  absl::StatusOr<InitStates> states = ReadInitStates(files.initial_states);
  if (!states.ok()) return WithRemedy(paths, states.status());
  result->init_states_ = *std::move(states);
  RS_RETURN_IF_ERROR(
      CheckInitStates(result->init_states_, result->scene_->model->nq, result->scene_->model->nv));
  RS_RETURN_IF_ERROR(CheckFreeBodies(result->init_states_, FreeBodies(*result->scene_->model)));
  RS_RETURN_IF_ERROR(
      CheckLimitedJoints(result->init_states_, LimitedJoints(*result->scene_->model)));
  RS_ASSIGN_OR_RETURN(const LiberoFixtures fixtures, ParseLiberoFixtures(unit.libero_fixtures));
  if (fixtures.source != LiberoFixtures::Source::kCentred) {
    RS_ASSIGN_OR_RETURN(FixturePoses poses,
                        FixturePoses::Create(fixtures, files.name, *result->scene_));
    RS_RETURN_IF_ERROR(poses.CheckListed(unit.first_initial_state, unit.episodes));
    result->fixture_poses_ = std::make_unique<FixturePoses>(std::move(poses));
  }
  return result;
}

absl::Status LiberoSimTask::MakeSimulator() {
  RS_ASSIGN_OR_RETURN(placed_model_, PlaceFixtures(*scene_, scene_->centred_fixtures));
  simulation_model_ = MakeSimulationModel(*placed_model_, init_states_.row(0) + 1);
  if (simulation_model_ == nullptr)
    return absl::ResourceExhaustedError("no memory for a copy of the model");
  RS_ASSIGN_OR_RETURN(render_model_, MakeRenderModel(*scene_, *simulation_model_));
  if (unit_.sim.pictures == SimOptions::kPlainPictures) ThinMeshes(*render_model_, kThinCell);
  RS_ASSIGN_OR_RETURN(sim_, PandaSim::Create(simulation_model_, unit_.sim));
  sim_->SetScenario(scenario_, horizon_);
  sim_->OnIntegrated([this] { goal_holds_ = goal_->Holds(sim_->data()); });
  return absl::OkStatus();
}

absl::Status LiberoSimTask::MoveFixtures(const std::vector<FixturePose>& poses) {
  RS_RETURN_IF_ERROR(libero::MoveFixtures(*scene_, poses, *placed_model_));
  return libero::MoveFixtures(*scene_, poses, *simulation_model_);
}

absl::Status LiberoSimTask::ResetDrawn(uint32_t seed) {
  RS_ASSIGN_OR_RETURN(NumpyPlacement placement, NumpyPlacement::Create(*scene_, seed));
  RS_ASSIGN_OR_RETURN(const ResetDraw draw, placement.Reset());
  success_ = false;
  drawn_ = true;
  RS_RETURN_IF_ERROR(MoveFixtures(draw.fixtures));
  RS_RETURN_IF_ERROR(sim_->Reset(draw.qpos, HomePosture()));
  return sim_->Settle(unit_.sim.settle_steps);
}

absl::Status LiberoSimTask::Reset(int initial_state) {
  if (initial_state >= kFirstTrainingDraw) return ResetDrawn(initial_state);
  if (initial_state < 0 || initial_state >= init_states_.rows) {
    return absl::OutOfRangeError(absl::StrCat(
        "initial state ", initial_state, " does not exist; ", init_states_.file, " has rows 0 to ",
        init_states_.rows - 1, ", from ", kFirstTrainingDraw, " on they are drawn"));
  }
  success_ = false;
  if (fixture_poses_ != nullptr) {
    RS_ASSIGN_OR_RETURN(const std::vector<FixturePose> poses, fixture_poses_->At(initial_state));
    RS_RETURN_IF_ERROR(MoveFixtures(poses));
  } else if (drawn_) {
    RS_RETURN_IF_ERROR(MoveFixtures(scene_->centred_fixtures));
  }
  drawn_ = false;
  const size_t nq = scene_->model->nq, nv = scene_->model->nv;
  const double* qpos = init_states_.row(initial_state) + 1;  // after the time
  absl::Status settled =
      ResetTo(absl::MakeConstSpan(qpos, nq), absl::MakeConstSpan(qpos + nq, nv), HomePosture());
  if (settled.ok()) settled = sim_->Settle(unit_.sim.settle_steps);
  if (settled.ok()) return settled;
  return absl::Status(settled.code(),
                      absl::StrCat(init_states_.file, ": row ", initial_state, ": ",
                                   settled.message(), ", or the row is no state of this scene"));
}

absl::Status LiberoSimTask::ResetTo(absl::Span<const double> qpos, absl::Span<const double> qvel,
                                    const Eigen::Matrix<double, 7, 1>& home) {
  const size_t nv = scene_->model->nv;
  if (qvel.size() != nv) {
    return absl::InvalidArgumentError(
        absl::StrCat("a state has ", qvel.size(), " velocities, the scene of '", name_, "' ", nv));
  }
  success_ = false;
  RS_RETURN_IF_ERROR(sim_->Reset(qpos, home));
  if (std::any_of(qvel.begin(), qvel.end(), [](double v) { return v != 0; }))
    std::copy(qvel.begin(), qvel.end(), sim_->mutable_data().qvel);
  return absl::OkStatus();
}

absl::Status LiberoSimTask::Step(const Eigen::VectorXf& command) {
  RS_RETURN_IF_ERROR(sim_->Step(command));
  success_ = goal_holds_;
  return absl::OkStatus();
}

absl::Status LiberoSimTask::StepExact(const Eigen::Matrix<double, 7, 1>& command, bool settling) {
  RS_RETURN_IF_ERROR(settling ? sim_->SettleWith(command) : sim_->StepExact(command));
  success_ = goal_holds_;
  return absl::OkStatus();
}

absl::StatusOr<Image> LiberoSimTask::RenderUpright(const std::string& camera,
                                                   const RenderOptions& options) {
  const mjData& data = sim_->observed();
  if (renderer_ == nullptr) {
    RS_ASSIGN_OR_RETURN(renderer_, Renderer::Create(render_model_));
  }
  // LIBERO lights a stove's burner while it is on.
  for (const auto& [name, object] : scene_->objects) {
    if (object.articulation == nullptr || !object.articulation->has_switch || object.joints.empty())
      continue;
    const int site = mj_name2id(render_model_.get(), mjOBJ_SITE, (name + "_burner").c_str());
    const double q = data.qpos[scene_->model->jnt_qposadr[object.joints[0]]];
    if (site >= 0)
      render_model_->site_rgba[4 * site + 3] = q >= object.articulation->on() ? 1.0f : 0.0f;
  }
  return renderer_->Render(data, camera, options);
}

absl::StatusOr<Observation> LiberoSimTask::Observe(const PolicySpec& spec) {
  const mjData& data = sim_->observed();
  const mjModel& model = sim_->model();
  RS_ASSIGN_OR_RETURN(const PandaModel panda, PandaModel::Find(model));
  Observation observation;
  observation.instruction = instruction_;
  observation.proprioception.resize(8);
  const Eigen::Vector3d rotation = AxisAngleAsRobosuite(data.xquat + 4 * panda.hand_body);
  for (int i = 0; i < 3; ++i) {
    observation.proprioception[i] = static_cast<float>(data.site_xpos[3 * panda.grip_site + i]);
    observation.proprioception[3 + i] = static_cast<float>(rotation[i]);
  }
  for (int i = 0; i < 2; ++i)
    observation.proprioception[6 + i] = static_cast<float>(data.qpos[panda.finger_qpos[i]]);
  for (const std::string& camera : spec.cameras) {
    const RenderOptions options = unit_.sim.pictures == SimOptions::kPlainPictures
                                      ? RenderOptions{.width = spec.image_width,
                                                      .height = spec.image_height,
                                                      .supersample = 2}
                                      : RenderAsLibero(kCameraSize, kCameraSize);
    RS_ASSIGN_OR_RETURN(Image upright, RenderUpright(camera, options));
    // The originals hand out OpenGL's bottom-up pixels and openpi's client rotates them by 180
    // degrees; that is the upright picture with left and right exchanged.
    observation.views.push_back(
        {camera, ResizeWithPad(MirrorColumns(upright), spec.image_width, spec.image_height)});
  }
  return observation;
}

absl::StatusOr<Image> LiberoSimTask::Film(int height) {
  RS_ASSIGN_OR_RETURN(const Image agent,
                      RenderUpright("agentview", RenderAsLibero(height, height)));
  RS_ASSIGN_OR_RETURN(const Image wrist,
                      RenderUpright("robot0_eye_in_hand", RenderAsLibero(height, height)));
  return HStack({agent, wrist}, 2);
}

absl::StatusOr<Expert> LiberoSimTask::MakeExpert() { return MakeLiberoExpert(*this); }

}  // namespace robostress::libero

namespace robostress {

absl::StatusOr<std::unique_ptr<SimTask>> MakeLiberoTask(const UnitConfig& unit, int task) {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<SimTask> result, libero::LiberoSimTask::Create(unit, task));
  return result;
}

}  // namespace robostress
