#include <algorithm>
#include <cstring>
#include <iterator>
#include <mutex>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "common/check.h"
#include "common/robot_description.h"
#include "common/status_macros.h"
#include "sim_worker/panda_sim_impl.h"

namespace robostress {
namespace {

// MuJoCo's default writes MUJOCO_LOG.TXT into the working directory. What matters is counted in
// mjData::warning, which Step turns into a status.
void IgnoreWarning(const char*) {}

}  // namespace

absl::StatusOr<SharedModel> CompileModel(const std::string& source, const std::string& mjcf) {
  static std::once_flag once;
  std::call_once(once, [] { mju_user_warning = IgnoreWarning; });
  constexpr char kFile[] = "scene.xml";
  const auto vfs = std::make_unique<mjVFS>();
  mj_defaultVFS(vfs.get());
  if (mj_makeEmptyFileVFS(vfs.get(), kFile, static_cast<int>(mjcf.size())) != 0) {
    return absl::InternalError(
        absl::StrFormat("%s: no memory for %d bytes of MJCF", source, mjcf.size()));
  }
  std::memcpy(vfs->filedata[mj_findFileVFS(vfs.get(), kFile)], mjcf.data(), mjcf.size());
  char error[1000] = "";
  mjModel* model = mj_loadXML(kFile, vfs.get(), error, sizeof(error));
  mj_deleteVFS(vfs.get());
  if (model == nullptr) {
    return absl::InvalidArgumentError(
        absl::StrFormat("%s: MJCF does not compile: %s", source, error));
  }
  return SharedModel(model, [](const mjModel* m) { mj_deleteModel(const_cast<mjModel*>(m)); });
}

int PandaSim::Impl::FreeBodyTouching(int contact_index, int pad) const {
  const mjContact& contact = data->contact[contact_index];
  const int geom = panda.finger_pad[pad];
  if (contact.geom1 != geom && contact.geom2 != geom) return -1;
  const int root =
      model->body_rootid[model->geom_bodyid[contact.geom1 == geom ? contact.geom2 : contact.geom1]];
  const bool free =
      model->body_jntnum[root] > 0 && model->jnt_type[model->body_jntadr[root]] == mjJNT_FREE;
  return free ? root : -1;
}

int PandaSim::Impl::HeldBody() const {
  for (int i = 0; i < data->ncon; ++i) {
    const int body = FreeBodyTouching(i, 0);
    if (body < 0) continue;
    for (int k = 0; k < data->ncon; ++k) {
      if (FreeBodyTouching(k, 1) == body) return body;
    }
  }
  return -1;
}

absl::StatusOr<std::unique_ptr<PandaSim>> PandaSim::Create(SharedModel model,
                                                           const SimOptions& options) {
  RS_CHECK(model != nullptr);
  RS_ASSIGN_OR_RETURN(const PandaModel panda, PandaModel::Find(*model));
  auto impl = std::make_unique<Impl>(std::move(model), options, panda);
  if (impl->data == nullptr)
    return absl::ResourceExhaustedError("no memory for mjData; lower njmax of the scene");
  std::unique_ptr<PandaSim> sim(new PandaSim(std::move(impl)));
  const mjModel& m = sim->model();
  RS_RETURN_IF_ERROR(sim->Reset(absl::MakeConstSpan(m.qpos0, m.nq), Vector7d::Zero()));
  return sim;
}

PandaSim::PandaSim(std::unique_ptr<Impl> impl) : impl_(std::move(impl)) {}
PandaSim::~PandaSim() = default;

void PandaSim::SetScenario(const Scenario& scenario, int horizon) {
  Impl& s = *impl_;
  s.episode.chain.SetScenario(scenario, horizon);
  s.believed.reset(s.episode.chain.has(EffectStage::kSensor) ? mj_makeData(s.model.get())
                                                             : nullptr);
}

absl::Status PandaSim::Reset(absl::Span<const double> qpos,
                             const Eigen::Matrix<double, 7, 1>& home) {
  Impl& s = *impl_;
  const mjModel* m = s.model.get();
  mjData* d = s.data.get();
  if (static_cast<int>(qpos.size()) != m->nq) {
    return absl::InvalidArgumentError(absl::StrFormat(
        "an initial state has %d positions, the model %d; it belongs to another scene", qpos.size(),
        m->nq));
  }
  EpisodeState& e = s.episode;
  mj_resetData(m, d);
  s.near_geoms.Forget();  // fixtures of the model may have been moved
  std::copy(qpos.begin(), qpos.end(), d->qpos);
  // robosuite's controller starts from the home posture: its first goal is the pose there, the goal
  // of the orientation stays there until a command rotates, and the first sub-step still acts on
  // the pose, Jacobian and masses of home (facts of LIBERO's reset,
  // docs/results/stepping-and-controller.md).
  for (int i = 0; i < 7; ++i) d->qpos[s.panda.qpos[i]] = home[i];
  s.Step1();
  s.Believe();
  ReadArm(*m, s.Believed(), s.panda, e.arm);
  e.controller.Reset(e.arm, home);
  for (int i = 0; i < 7; ++i) d->qpos[s.panda.qpos[i]] = qpos[s.panda.qpos[i]];
  s.parity() ? mj_forward(m, d) : s.Step1();
  if (!s.options.robosuite.home_goal) {
    ArmState start;
    s.Believe();
    ReadArm(*m, s.Believed(), s.panda, start);
    e.controller.Reset(start, start.q);
  }
  e.first_sub_step = s.options.robosuite.stale_reset_pose;
  e.gripper = {};
  e.steps = 0;
  e.clock = 0;
  const Vector7d holding = GravityTorque(*m, *d, s.panda);
  JointMoments moments = s.DescribeJoints();
  for (int i = 0; i < 7; ++i) {
    moments[i].q = d->qpos[s.panda.qpos[i]];
    moments[i].drive = holding[i];
  }
  e.chain.Reset(moments);
  s.position_stage_stale = false;
  s.late.pose_qpos.assign(d->qpos, d->qpos + m->nq);
  s.late.qpos = s.late.pose_qpos;
  s.late.qvel.assign(m->nv, 0);
  s.late.current = false;
  return CheckWarnings(*d);
}

absl::Status PandaSim::Settle(int steps) {
  Vector7d open = Vector7d::Zero();
  open[6] = -1;
  for (int i = 0; i < steps; ++i) RS_RETURN_IF_ERROR(SettleWith(open));
  return absl::OkStatus();
}

absl::Status PandaSim::SettleWith(const Vector7d& command) {
  return impl_->ControlStep(command, 0);
}

absl::Status PandaSim::Step(const Eigen::VectorXf& command) {
  if (command.size() != 7) {
    return absl::InvalidArgumentError(
        absl::StrFormat("a command has %d values; it must have 7", command.size()));
  }
  return StepExact(command.cast<double>());
}

absl::Status PandaSim::StepExact(const Vector7d& command) {
  RS_RETURN_IF_ERROR(impl_->ControlStep(command, impl_->episode.steps));
  ++impl_->episode.steps;
  return absl::OkStatus();
}

RobotState PandaSim::Measure() const {
  const Impl& s = *impl_;
  const mjData& d = observed();
  RobotState state;
  state.stamp_s = s.episode.steps * kPanda.control_period_s;
  state.q.resize(7);
  state.dq.resize(7);
  for (int i = 0; i < 7; ++i) {
    state.q[i] = d.qpos[s.panda.qpos[i]];
    state.dq[i] = d.qvel[s.panda.dof[i]];
  }
  using Map3 = Eigen::Map<const Eigen::Vector3d>;
  state.tool.p_base_tool =
      Map3(d.site_xpos + 3 * s.panda.grip_site) - Map3(d.xpos + 3 * s.panda.base_body);
  const double* q = d.xquat + 4 * s.panda.hand_body;
  state.tool.q_base_tool = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  state.gripper = d.qpos[s.panda.finger_qpos[0]] - d.qpos[s.panda.finger_qpos[1]];
  return state;
}

bool PandaSim::GraspDetected() const { return impl_->HeldBody() >= 0; }
int PandaSim::held_body() const { return impl_->HeldBody(); }
int PandaSim::steps_taken() const { return impl_->episode.steps; }
const mjModel& PandaSim::model() const { return *impl_->model; }
SharedModel PandaSim::shared_model() const { return impl_->model; }
const mjData& PandaSim::data() const { return *impl_->data; }
const mjData& PandaSim::observed() const { return impl_->Observed(); }
const OscController& PandaSim::controller() const { return impl_->episode.controller; }
const JointChain& PandaSim::joint_chain() const { return impl_->episode.chain; }
void PandaSim::OnSubStep(std::function<void()> call) { impl_->on_sub_step = std::move(call); }
void PandaSim::OnJointSample(std::function<void(const JointSample&)> call) {
  impl_->on_sample = std::move(call);
}
void PandaSim::OnIntegrated(std::function<void()> call) { impl_->on_integrated = std::move(call); }

mjData& PandaSim::mutable_data() {
  impl_->position_stage_stale = true;
  return *impl_->data;
}

std::shared_ptr<const PandaSim::Snapshot> PandaSim::Save() const {
  const Impl& s = *impl_;
  const mjModel& m = *s.model;
  const mjData& d = *s.data;
  return std::make_shared<const Snapshot>(Snapshot{s.episode,
                                                   d.time,
                                                   {d.qpos, d.qpos + m.nq},
                                                   {d.qvel, d.qvel + m.nv},
                                                   {d.act, d.act + m.na},
                                                   {d.ctrl, d.ctrl + m.nu},
                                                   {d.qacc_warmstart, d.qacc_warmstart + m.nv},
                                                   {d.mocap_pos, d.mocap_pos + 3 * m.nmocap},
                                                   {d.mocap_quat, d.mocap_quat + 4 * m.nmocap},
                                                   s.late.pose_qpos,
                                                   s.late.qpos,
                                                   s.late.qvel});
}

void PandaSim::RestoreMotion(const Snapshot& snapshot) {
  const JointChain own = impl_->episode.chain;
  Restore(snapshot);
  impl_->episode.chain = own;
}

void PandaSim::Restore(const Snapshot& snapshot) {
  Impl& s = *impl_;
  mjData* d = s.data.get();
  RS_CHECK(static_cast<int>(snapshot.qpos.size()) == s.model->nq);
  // Everything that a step reads and does not compute; mj_resetData would clear its megabytes too.
  mju_zero(d->qfrc_applied, s.model->nv);
  mju_zero(d->xfrc_applied, 6 * s.model->nbody);
  std::fill(std::begin(d->warning), std::end(d->warning), mjWarningStat{});
  s.episode = snapshot.episode;
  d->time = snapshot.time;
  std::copy(snapshot.qpos.begin(), snapshot.qpos.end(), d->qpos);
  std::copy(snapshot.qvel.begin(), snapshot.qvel.end(), d->qvel);
  std::copy(snapshot.act.begin(), snapshot.act.end(), d->act);
  std::copy(snapshot.ctrl.begin(), snapshot.ctrl.end(), d->ctrl);
  std::copy(snapshot.warmstart.begin(), snapshot.warmstart.end(), d->qacc_warmstart);
  std::copy(snapshot.mocap_pos.begin(), snapshot.mocap_pos.end(), d->mocap_pos);
  std::copy(snapshot.mocap_quat.begin(), snapshot.mocap_quat.end(), d->mocap_quat);
  s.late.pose_qpos = snapshot.late_pose_qpos;
  s.late.qpos = snapshot.late_qpos;
  s.late.qvel = snapshot.late_qvel;
  s.late.current = false;
  s.near_geoms.Forget();  // as in Reset
  s.Step1();
  s.position_stage_stale = false;
}

}  // namespace robostress
