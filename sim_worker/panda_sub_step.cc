#include <algorithm>

#include "absl/strings/str_format.h"
#include "sim_worker/panda_sim_impl.h"

namespace robostress {
namespace {

constexpr int kSubSteps = 25;
constexpr int kLateSubStep = 23;  // robosuite's observables fall due after this one, from 0
constexpr double kGripperPerSubStep = 0.01;  // of the half stroke

}  // namespace

absl::Status CheckWarnings(const mjData& data) {
  // MuJoCo then drives no motor at all, and the state stays finite.
  if (const mjWarningStat& bad = data.warning[mjWARN_BADCTRL]; bad.number > 0) {
    return absl::InternalError(absl::StrFormat(
        "the simulation diverged (%s) at t = %.3f s: a joint's torque is no number; a parameter of "
        "the scenario's effects is out of all proportion",
        mju_warningText(mjWARN_BADCTRL, bad.lastinfo), data.time));
  }
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

void PandaSim::Impl::Step1() {
  const mjModel* m = model.get();
  mjData* d = data.get();
  mj_checkPos(m, d);
  mj_checkVel(m, d);
  mj_kinematics(m, d);
  mj_comPos(m, d);
  mj_camlight(m, d);
  mj_tendon(m, d);
  mj_crb(m, d);
  mj_factorM(m, d);
  near_geoms.Collide(*d);
  mj_makeConstraint(m, d);
  mj_transmission(m, d);
  mj_projectConstraint(m, d);
  mj_sensorPos(m, d);
  mj_energyPos(m, d);
  mj_fwdVelocity(m, d);
  mj_sensorVel(m, d);
  mj_energyVel(m, d);
}

void PandaSim::Impl::Integrate(const Vector7d& offset_change) {
  const bool moved = episode.chain.has(EffectStage::kTransmission);
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
  if (!parity()) Step1();
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
  for (int i = 0; i < 7; ++i) q[i] = episode.chain.Reading(i, data->qpos[panda.qpos[i]]);
  return q;
}

Vector7d PandaSim::Impl::ReadingRates() const {
  Vector7d dq;
  for (int i = 0; i < 7; ++i) {
    const double slope = episode.chain.ReadingSlope(i, data->qpos[panda.qpos[i]]);
    dq[i] = slope * data->qvel[panda.dof[i]];
  }
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
  e.chain.BeginSubStep(model->opt.timestep);
  const Vector7d asked = e.controller.Torque(e.arm, e.bias);
  JointMoments moments = DescribeJoints();
  const Vector7d tau_load = LoadTorque(asked, moments);
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
  if (position_stage_stale && !parity()) Step1();
  position_stage_stale = false;
  const bool gated = episode.chain.severity().scenario().profile == SeverityProfile::kWhileGrasping;
  for (int i = 0; i < kSubSteps; ++i) {
    LookAtArm();
    if (i == 0) {
      episode.controller.SetGoal(delta, episode.arm);
      episode.chain.BeginControlStep(progress_steps, gated && HeldBody() >= 0);
    }
    DriveGripper(gripper);
    late.keep = late.data != nullptr && i == kLateSubStep;
    last_sub_step = i == kSubSteps - 1;
    SubStep();
    if (on_sub_step) on_sub_step();
  }
  return CheckWarnings(*data);
}

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

}  // namespace robostress
