#include <Eigen/Cholesky>
#include <algorithm>
#include <limits>

#include "common/joint_errors/friction.h"
#include "sim_worker/panda_sim_impl.h"

namespace robostress {

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

}  // namespace robostress
