#include "sim_worker/panda_sim.h"

#include <Eigen/Cholesky>
#include <algorithm>
#include <cstring>
#include <limits>
#include <mutex>
#include <utility>
#include <vector>

#include "absl/strings/str_format.h"
#include "common/check.h"
#include "common/joint_errors/effect_stack.h"
#include "common/joint_errors/friction.h"
#include "common/joint_errors/joint_error_stack.h"
#include "common/status_macros.h"
#include "sim_worker/osc_controller.h"
#include "sim_worker/panda_model.h"

namespace robostress {
namespace {

constexpr int kSubSteps = 25;
constexpr int kLateSubStep = 23;         // robosuite's observables fall due after this one, from 0
constexpr double kControlPeriod = 0.05;  // [s]
constexpr double kGripperPerSubStep = 0.01;  // of the half stroke

// MuJoCo's default writes MUJOCO_LOG.TXT into the working directory. What matters is counted in
// mjData::warning, which Step turns into a status.
void IgnoreWarning(const char*) {}

struct DataDeleter {
  void operator()(mjData* data) const { mj_deleteData(data); }
};
using DataPtr = std::unique_ptr<mjData, DataDeleter>;

// Warnings after which the state is not that of the task any more.
absl::Status CheckWarnings(const mjData& data) {
  for (const mjtWarning kind : {mjWARN_BADQPOS, mjWARN_BADQVEL, mjWARN_BADQACC}) {
    if (data.warning[kind].number > 0) {
      return absl::InternalError(
          absl::StrFormat("the simulation diverged (%s) at t = %.3f s, degree of freedom %d; "
                          "severities or the stepping options are "
                          "beyond what 2 ms sub-steps integrate",
                          mju_warningText(kind, data.warning[kind].lastinfo), data.time,
                          data.warning[kind].lastinfo));
    }
  }
  for (const mjtWarning kind : {mjWARN_CONTACTFULL, mjWARN_CNSTRFULL}) {
    if (data.warning[kind].number > 0) {
      return absl::ResourceExhaustedError(
          absl::StrFormat("%s; raise <size nconmax njmax> of the scene",
                          mju_warningText(kind, data.warning[kind].lastinfo)));
    }
  }
  return absl::OkStatus();
}

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

// The state of an episode beside mjData: everything that a continuation depends on.
struct EpisodeState {
  EpisodeState(const SimOptions& options)
      : controller(options.goal_reference, options.SinglePrecisionRotation()),
        errors(options.joint_errors) {}

  OscController controller;
  JointErrorStack errors;
  EffectStack effects;
  ArmState arm;                      // what the controller saw last
  Vector7d bias = Vector7d::Zero();  // its model of Coriolis, centrifugal and gravity torque [Nm]
  double clock = 0;                  // [s] since Reset
  std::array<double, 2> gripper{};   // integrated gripper command in +-1, per finger
  int steps = 0;                     // control steps since Reset, settling excluded
  bool first_sub_step = true;        // see Reset
};

struct PandaSim::Snapshot {
  EpisodeState episode;
  double time;
  std::vector<double> qpos, qvel, act, ctrl, warmstart, mocap_pos, mocap_quat;
  std::vector<double> late_pose_qpos, late_qpos, late_qvel;
};

struct PandaSim::Impl {
  Impl(SharedModel shared, const SimOptions& o, const PandaModel& p)
      : model(std::move(shared)), data(mj_makeData(model.get())), options(o), panda(p), episode(o) {
    if (options.LateObservation()) late.data.reset(mj_makeData(model.get()));
  }

  bool parity() const { return options.stepping == Stepping::kParity; }
  // The forward passes of a sub-step, and the arm as the controller then sees it.
  void LookAtArm();
  // The arm of the joint readings and the bias that the controller compensates; the truth without
  // sensor effects. Believe brings its kinematics up to date.
  void Believe();
  const mjData& Believed() const { return believed == nullptr ? *data : *believed; }
  Vector7d Readings() const;
  Vector7d ReadingRates() const;
  void SubStep();
  const mjData& Observed();
  absl::Status ControlStep(const Vector7d& command, int progress_steps);
  Vector7d Saturated(const Vector7d& torque) const;
  Vector7d PerturbedTorque(const Vector7d& controller_torque);
  Vector7d TorqueWithEffects(const Vector7d& controller_torque, EffectStack::Moments& moments);
  EffectStack::Moments DescribeJoints() const;
  Vector7d NetTorque(const Vector7d& applied) const;
  Vector7d OffsetChange(const Vector7d& tau_load, EffectStack::Moments& moments);
  double ContactForce() const;
  void DriveGripper(double direction);
  void Integrate(const Vector7d& offset_change);
  // Root body with a free joint that `pad` touches in a contact, or -1.
  int FreeBodyTouching(int contact_index, int pad) const;
  int HeldBody() const;

  const SharedModel model;
  const DataPtr data;
  const SimOptions options;
  const PandaModel panda;
  EpisodeState episode;
  bool position_stage_stale = false;  // somebody may have written to data since the last mj_step1
  std::function<void()> on_sub_step, on_integrated;
  std::function<void(const JointSample&)> on_sample;
  bool last_sub_step = false;  // of a control step
  double contact_N = 0;        // of this sub-step, while somebody listens
  DataPtr believed;            // kinematics of the readings; null without sensor effects

  // An observation that is older than the end of the control step: kinematics of the positions from
  // which its sub-step started, positions and velocities of its end.
  struct LateObservation {
    DataPtr data;  // null: observations are of data
    std::vector<double> pose_qpos, qpos, qvel;
    bool keep = false;    // this sub-step's
    bool current = true;  // data holds it
  } late;
};

const mjData& PandaSim::Impl::Observed() {
  if (late.data == nullptr) return *data;
  if (late.current) return *late.data;
  mjData* d = late.data.get();
  std::copy(late.pose_qpos.begin(), late.pose_qpos.end(), d->qpos);
  std::copy_n(data->mocap_pos, 3 * model->nmocap, d->mocap_pos);
  std::copy_n(data->mocap_quat, 4 * model->nmocap, d->mocap_quat);
  mj_kinematics(model.get(), d);
  mj_comPos(model.get(), d);
  mj_camlight(model.get(), d);
  std::copy(late.qpos.begin(), late.qpos.end(), d->qpos);
  std::copy(late.qvel.begin(), late.qvel.end(), d->qvel);
  late.current = true;
  return *d;
}

Vector7d PandaSim::Impl::Saturated(const Vector7d& torque) const {
  return torque.cwiseMax(-panda.torque_limit).cwiseMin(panda.torque_limit);
}

Vector7d PandaSim::Impl::PerturbedTorque(const Vector7d& controller_torque) {
  const JointErrorStack& errors = episode.errors;
  const Scenario& scenario = errors.scenario();
  if (!errors.torque_stage()) return Saturated(controller_torque);
  Vector7d dq;
  for (int i = 0; i < 7; ++i) dq[i] = data->qvel[panda.dof[i]];
  const Vector7d gravity =
      scenario.gravity_on ? GravityTorque(*model, *data, panda) : Vector7d(Vector7d::Zero());
  if (!scenario.friction_on || options.joint_errors.friction_law != FrictionLaw::kStick) {
    return errors.PerturbTorque(controller_torque, dq, gravity, panda.torque_limit);
  }
  // Stick: dry friction that would bring the joints to rest within this sub-step, given all other
  // torques; those of contacts and joint limits are the previous sub-step's.
  const Vector7d torque = errors.TorqueWithoutDryFriction(controller_torque, dq, gravity);
  const Vector7d net = NetTorque(Saturated(torque));
  const double h = model->opt.timestep;
  const Eigen::LLT<Matrix7d> M(episode.arm.M);
  const JointErrorStack::Matrix velocity_per_torque = h * M.solve(Matrix7d::Identity());
  const Vector7d v_free = dq + velocity_per_torque * net;
  return errors.AddStickFriction(torque, dq, v_free, velocity_per_torque, panda.torque_limit);
}

// With the motors' torques `applied`; forces of contacts and joint limits are the previous
// sub-step's.
Vector7d PandaSim::Impl::NetTorque(const Vector7d& applied) const {
  Vector7d net;
  for (int i = 0; i < 7; ++i) {
    const int dof = panda.dof[i];
    net[i] =
        applied[i] + data->qfrc_passive[dof] - data->qfrc_bias[dof] + data->qfrc_constraint[dof];
  }
  return net;
}

// Joints at the start of a sub-step; `drive` is filled by the stack. The payload's place is the
// tool site.
EffectStack::Moments PandaSim::Impl::DescribeJoints() const {
  const EpisodeState& e = episode;
  const Eigen::Vector3d field(model->opt.gravity);
  const Vector7d gravity = GravityTorque(*model, *data, panda);
  // A base that turns by a small angle about an axis sees gravity turn the other way.
  const Vector7d tilt_x =
      GravityTorque(*model, *data, panda, -Eigen::Vector3d::UnitX().cross(field));
  const Vector7d tilt_y =
      GravityTorque(*model, *data, panda, -Eigen::Vector3d::UnitY().cross(field));
  const Eigen::Vector3d tool(data->site_xpos + 3 * panda.grip_site);
  EffectStack::Moments moments;
  for (int i = 0; i < 7; ++i) {
    JointMoment& m = moments[i];
    m.t = e.clock;
    m.h = model->opt.timestep;
    m.q = data->qpos[panda.qpos[i]] - e.errors.offset()[i] - e.effects.offset()[i];
    m.dq = data->qvel[panda.dof[i]];
    m.gravity = gravity[i];
    m.tilt_gravity[0] = tilt_x[i];
    m.tilt_gravity[1] = tilt_y[i];
    const Eigen::Vector3d axis(data->xaxis + 3 * panda.joint[i]);
    const Eigen::Vector3d arm = tool - Eigen::Vector3d(data->xanchor + 3 * panda.joint[i]);
    const Eigen::Vector3d column = axis.cross(arm);
    m.payload_gravity = -column.dot(field);
    m.payload_inertia = column.squaredNorm();
    if (const int other = e.effects.coupled(i); other >= 0)
      m.coupled_q = data->qpos[panda.qpos[other]];
  }
  return moments;
}

// The library's effects and the paper's errors together. All dry friction that has a stick law, the
// paper's under friction_law: stick and the library's always, is one problem.
Vector7d PandaSim::Impl::TorqueWithEffects(const Vector7d& controller_torque,
                                           EffectStack::Moments& moments) {
  EpisodeState& e = episode;
  const JointErrorStack& errors = e.errors;
  const Scenario& scenario = errors.scenario();
  const Vector7d drive = e.effects.Drive(controller_torque, moments);
  EffectStack::JointTorques joints = e.effects.Torques(moments);
  Vector7d torque = drive + joints.torque, dq, gravity;
  for (int i = 0; i < 7; ++i) {
    dq[i] = moments[i].dq;
    gravity[i] = moments[i].gravity;
  }
  const bool stick = options.joint_errors.friction_law == FrictionLaw::kStick;
  if (stick || !scenario.friction_on) {
    torque = errors.TorqueWithoutDryFriction(torque, dq, gravity);
  } else {
    const Vector7d unlimited = Vector7d::Constant(std::numeric_limits<double>::infinity());
    torque = errors.PerturbTorque(torque, dq, gravity, unlimited);
  }
  Vector7d forward, backward;
  for (int i = 0; i < 7; ++i) {
    const double own =
        stick && scenario.friction_on ? StribeckMagnitude(errors.parameters()[i], dq[i]) : 0;
    forward[i] = std::max(0.0, joints.dry[i].forward + own);
    backward[i] = std::max(0.0, joints.dry[i].backward + own);
  }
  // M is the arm's, whatever its encoders say; what a payload adds to a joint's inertia goes into
  // MuJoCo as the torque that it takes.
  ArmState arm;
  ReadArm(*model, *data, panda, arm);
  const Matrix7d M = arm.M + Matrix7d(joints.inertia.asDiagonal());
  const JointErrorStack::Matrix M_inverse = Eigen::LLT<Matrix7d>(M).solve(Matrix7d::Identity());
  const Vector7d net = NetTorque(Saturated(torque));
  const double h = model->opt.timestep;
  const JointErrorStack::Matrix velocity_per_torque = h * M_inverse;
  const Vector7d v_free = dq + velocity_per_torque * net;
  Vector7d friction;
  StickTorques({v_free.data(), 7}, {velocity_per_torque.data(), 49}, {forward.data(), 7},
               {backward.data(), 7}, {friction.data(), 7});
  const Vector7d acceleration = M_inverse * (net + friction);
  torque += friction - joints.inertia.cwiseProduct(acceleration);
  return Saturated(torque);
}

// Position stage of both: backlash and compliance of the paper from the motor's angle now, effects
// from the angle that the sub-step leads to.
Vector7d PandaSim::Impl::OffsetChange(const Vector7d& tau_load, EffectStack::Moments& moments) {
  EpisodeState& e = episode;
  Vector7d change = Vector7d::Zero();
  if (e.errors.position_stage()) {
    Vector7d q;
    for (int i = 0; i < 7; ++i) q[i] = data->qpos[panda.qpos[i]] - e.effects.offset()[i];
    change = e.errors.OffsetChange(q, tau_load);
  }
  if (e.effects.has(EffectStage::kTransmission)) {
    for (JointMoment& m : moments) m.q += m.h * m.dq;
    change += e.effects.OffsetChange(moments);
  }
  return change;
}

// Needs contacts and solver forces of one and the same sub-step.
double PandaSim::Impl::ContactForce() const {
  double sum = 0;
  for (int i = 0; i < data->ncon; ++i) {
    const mjContact& contact = data->contact[i];
    const int root1 = model->body_rootid[model->geom_bodyid[contact.geom1]];
    const int root2 = model->body_rootid[model->geom_bodyid[contact.geom2]];
    if (root1 != panda.base_body && root2 != panda.base_body) continue;
    double wrench[6];
    mj_contactForce(model.get(), data.get(), i, wrench);
    sum += Eigen::Vector3d(wrench).norm();
  }
  return sum;
}

void PandaSim::Impl::DriveGripper(double direction) {
  // robosuite: finger 1 opens towards the upper end of its range, finger 2 towards its lower end.
  constexpr double kOpening[2] = {1, -1};
  for (int i = 0; i < 2; ++i) {
    double& command = episode.gripper[i];
    command = std::clamp(command - kOpening[i] * kGripperPerSubStep * direction, -1.0, 1.0);
    data->ctrl[panda.finger_motor[i]] = panda.finger_mid[i] + panda.finger_half[i] * command;
  }
}

void PandaSim::Impl::Integrate(const Vector7d& offset_change) {
  const bool moved =
      episode.errors.position_stage() || episode.effects.has(EffectStage::kTransmission);
  // The offset travels as a velocity of one sub-step, seen by contacts, damping and Coriolis terms.
  const bool as_velocity = moved && options.joint_errors.offset_mode == OffsetMode::kVelocity;
  const Vector7d velocity = offset_change / model->opt.timestep;
  for (int i = 0; i < 7; ++i) {
    if (as_velocity) data->qvel[panda.dof[i]] += velocity[i];
    if (moved && !as_velocity) data->qpos[panda.qpos[i]] += offset_change[i];
  }
  if (late.keep) late.pose_qpos.assign(data->qpos, data->qpos + model->nq);
  if (parity() || (moved && options.stepping == Stepping::kReference)) {
    mj_step(model.get(), data.get());
  } else {
    if (as_velocity) mj_fwdVelocity(model.get(), data.get());
    mj_step2(model.get(), data.get());
  }
  if (on_sample) contact_N = ContactForce();
  if (as_velocity) {
    for (int i = 0; i < 7; ++i) data->qvel[panda.dof[i]] -= velocity[i];
  }
  if (late.keep) {
    late.qpos.assign(data->qpos, data->qpos + model->nq);
    late.qvel.assign(data->qvel, data->qvel + model->nv);
    late.current = false;
  }
  if (last_sub_step && on_integrated) on_integrated();
  if (!parity()) mj_step1(model.get(), data.get());
}

void PandaSim::Impl::LookAtArm() {
  EpisodeState& e = episode;
  if (parity()) {
    // The environment's forward, then the controller's, which is left out in the first sub-step
    // after a reset. What they add to the results is the solver's warm start.
    mj_forward(model.get(), data.get());
    if (!e.first_sub_step) mj_forward(model.get(), data.get());
  }
  Believe();
  if (!e.first_sub_step) ReadArm(*model, Believed(), panda, e.arm);
  for (int i = 0; i < 7; ++i) e.bias[i] = Believed().qfrc_bias[panda.dof[i]];
  e.first_sub_step = false;
}

Vector7d PandaSim::Impl::Readings() const {
  Vector7d q;
  for (int i = 0; i < 7; ++i) q[i] = episode.effects.Reading(i, data->qpos[panda.qpos[i]]);
  return q;
}

Vector7d PandaSim::Impl::ReadingRates() const {
  Vector7d dq;
  for (int i = 0; i < 7; ++i) dq[i] = episode.effects.ReadingSlope(i) * data->qvel[panda.dof[i]];
  return dq;
}

void PandaSim::Impl::Believe() {
  if (believed == nullptr) return;
  mjData* d = believed.get();
  std::copy_n(data->qpos, model->nq, d->qpos);
  std::copy_n(data->qvel, model->nv, d->qvel);
  const Vector7d q = Readings(), dq = ReadingRates();
  for (int i = 0; i < 7; ++i) {
    d->qpos[panda.qpos[i]] = q[i];
    d->qvel[panda.dof[i]] = dq[i];
  }
  mj_kinematics(model.get(), d);
  mj_comPos(model.get(), d);
  mj_crb(model.get(), d);
  mj_comVel(model.get(), d);
  mj_rne(model.get(), d, 0, d->qfrc_bias);
}

void PandaSim::Impl::SubStep() {
  EpisodeState& e = episode;
  e.errors.BeginSubStep(model->opt.timestep);
  const Vector7d asked = e.controller.Torque(e.arm, e.bias);
  EffectStack::Moments moments;
  if (e.effects.any()) moments = DescribeJoints();
  const Vector7d tau_load =
      e.effects.any() ? TorqueWithEffects(asked, moments) : PerturbedTorque(asked);
  for (int i = 0; i < 7; ++i) data->ctrl[panda.motor[i]] = tau_load[i];
  JointSample sample;
  if (on_sample) sample = {e.clock, Readings(), ReadingRates(), Saturated(asked), 0};
  Integrate(OffsetChange(tau_load, moments));
  e.clock += model->opt.timestep;
  if (on_sample) {
    sample.contact_N = contact_N;
    on_sample(sample);
  }
}

absl::Status PandaSim::Impl::ControlStep(const Vector7d& command, int progress_steps) {
  if (!command.allFinite()) {
    return absl::InvalidArgumentError("a command has values that are not finite");
  }
  const Eigen::Matrix<double, 6, 1> delta = command.head<6>().cwiseMax(-1).cwiseMin(1);
  const double gripper = (command[6] > 0) - (command[6] < 0);
  if (position_stage_stale && !parity()) mj_step1(model.get(), data.get());
  position_stage_stale = false;
  const bool gated = episode.errors.scenario().profile == SeverityProfile::kWhileGrasping;
  for (int i = 0; i < kSubSteps; ++i) {
    LookAtArm();
    if (i == 0) {
      episode.controller.SetGoal(delta, episode.arm);
      episode.errors.BeginControlStep(progress_steps, gated && HeldBody() >= 0);
    }
    DriveGripper(gripper);
    late.keep = late.data != nullptr && i == kLateSubStep;
    last_sub_step = i == kSubSteps - 1;
    SubStep();
    if (on_sub_step) on_sub_step();
  }
  return CheckWarnings(*data);
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
  s.episode.errors.SetScenario(scenario, horizon);
  s.episode.effects.SetScenario(scenario);
  s.believed.reset(s.episode.effects.has(EffectStage::kSensor) ? mj_makeData(s.model.get())
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
  std::copy(qpos.begin(), qpos.end(), d->qpos);
  // robosuite's controller starts from the home posture: its first goal is the pose there, the goal
  // of the orientation stays there until a command rotates, and the first sub-step still acts on
  // the pose, Jacobian and masses of home (facts of LIBERO's reset, sim_worker/README.md).
  for (int i = 0; i < 7; ++i) d->qpos[s.panda.qpos[i]] = home[i];
  mj_step1(m, d);
  s.Believe();
  ReadArm(*m, s.Believed(), s.panda, e.arm);
  e.controller.Reset(e.arm, home);
  for (int i = 0; i < 7; ++i) d->qpos[s.panda.qpos[i]] = qpos[s.panda.qpos[i]];
  s.parity() ? mj_forward(m, d) : mj_step1(m, d);
  if (!s.options.robosuite.home_goal) {
    ArmState start;
    s.Believe();
    ReadArm(*m, s.Believed(), s.panda, start);
    e.controller.Reset(start, start.q);
  }
  e.first_sub_step = s.options.robosuite.stale_reset_pose;
  e.gripper = {};
  e.steps = 0;
  Vector7d q;
  for (int i = 0; i < 7; ++i) q[i] = d->qpos[s.panda.qpos[i]];
  e.errors.Reset(q, GravityTorque(*m, *d, s.panda));
  e.clock = 0;
  if (e.effects.any()) {
    EffectStack::Moments moments = s.DescribeJoints();
    for (int i = 0; i < 7; ++i) {
      moments[i].q = q[i] - e.errors.offset()[i];
      moments[i].drive = moments[i].gravity;
    }
    e.effects.Reset(moments);
  }
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
  state.stamp_s = s.episode.steps * kControlPeriod;
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
const mjData& PandaSim::data() const { return *impl_->data; }
const mjData& PandaSim::observed() const { return impl_->Observed(); }
const OscController& PandaSim::controller() const { return impl_->episode.controller; }
const JointErrorStack& PandaSim::errors() const { return impl_->episode.errors; }
const EffectStack& PandaSim::effects() const { return impl_->episode.effects; }
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

void PandaSim::Restore(const Snapshot& snapshot) {
  Impl& s = *impl_;
  mjData* d = s.data.get();
  RS_CHECK(static_cast<int>(snapshot.qpos.size()) == s.model->nq);
  mj_resetData(s.model.get(), d);
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
  mj_step1(s.model.get(), d);
  s.position_stage_stale = false;
}

}  // namespace robostress
