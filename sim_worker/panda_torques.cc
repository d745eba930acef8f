#include <algorithm>

#include "common/joint_errors/sub_step.h"
#include "sim_worker/panda_sim_impl.h"

namespace robostress {
namespace {

absl::Span<double> Values(Vector7d& vector) { return {vector.data(), 7}; }

}  // namespace

// NaN stays NaN, so that CheckWarnings hears of it; of cwiseMax it may become a limit.
Vector7d PandaSim::Impl::Saturated(const Vector7d& torque) const {
  Vector7d saturated;
  for (int i = 0; i < 7; ++i)
    saturated[i] = std::clamp(torque[i], -panda.torque_limit[i], panda.torque_limit[i]);
  return saturated;
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

// Joints at the start of a sub-step, as far as the chain reads them; it fills `drive`. The
// payload's place is the tool site.
JointMoments PandaSim::Impl::DescribeJoints() const {
  const EpisodeState& e = episode;
  const JointChain& chain = e.chain;
  JointMoments moments;
  for (int i = 0; i < 7; ++i) {
    JointMoment& m = moments[i];
    m.t = e.clock;
    m.h = model->opt.timestep;
    m.q = chain.MotorAngle(i, data->qpos[panda.qpos[i]]);
    m.dq = data->qvel[panda.dof[i]];
    if (const int other = chain.coupled(i); other >= 0) {
      m.coupled_q = data->qpos[panda.qpos[other]];
      m.coupled_dq = data->qvel[panda.dof[other]];
      m.coupled_ddq = data->qacc[panda.dof[other]];
    }
  }
  const Eigen::Vector3d field(model->opt.gravity);
  if (chain.reads() & kGravityField) {
    const Vector7d gravity = GravityTorque(*model, *data, panda);
    for (int i = 0; i < 7; ++i) moments[i].gravity = gravity[i];
  }
  // A base that turns by a small angle about an axis sees gravity turn the other way.
  for (int axis = 0; axis < 2 && chain.reads() & kTiltField; ++axis) {
    const Vector7d tilt =
        GravityTorque(*model, *data, panda, -Eigen::Vector3d::Unit(axis).cross(field));
    for (int i = 0; i < 7; ++i) moments[i].tilt_gravity[axis] = tilt[i];
  }
  const Eigen::Vector3d tool(data->site_xpos + 3 * panda.grip_site);
  for (int i = 0; i < 7 && chain.reads() & kPayloadFields; ++i) {
    const Eigen::Vector3d axis(data->xaxis + 3 * panda.joint[i]);
    const Eigen::Vector3d arm = tool - Eigen::Vector3d(data->xanchor + 3 * panda.joint[i]);
    const Eigen::Vector3d column = axis.cross(arm);
    moments[i].payload_gravity = -column.dot(field);
    moments[i].payload_inertia = column.squaredNorm();
  }
  return moments;
}

// The arm around its chain. Beside effects its masses are read anew, whatever its encoders say; the
// paper's errors alone meet those that the controller saw, the same but in the first sub-step after
// a reset.
template <bool kEffects>
struct PandaSim::Impl::ChainPlant {
  using Inverse = Eigen::Matrix<double, 7, 7, kEffects ? Eigen::RowMajor : Eigen::ColMajor>;
  const Impl& sim;
  double rest = 0, h = sim.model->opt.timestep;

  Vector7d Limited(const Vector7d& torque) const { return sim.Saturated(torque); }
  Vector7d Net(const Vector7d& torque) const { return sim.NetTorque(torque); }
  Matrix7d MassMatrix() const {
    if constexpr (!kEffects) return sim.episode.arm.M;
    ArmState arm;
    ReadArm(*sim.model, *sim.data, sim.panda, arm);
    return arm.M;
  }
  Vector7d Velocities() const {
    Vector7d dq;
    for (int i = 0; i < 7; ++i) dq[i] = sim.data->qvel[sim.panda.dof[i]];
    return dq;
  }
};

// What the joints get of the controller's torques [Nm].
Vector7d PandaSim::Impl::LoadTorque(const Vector7d& asked, JointMoments& moments) {
  JointChain& chain = episode.chain;
  const Vector7d none = Vector7d::Zero();
  const auto joints = absl::MakeSpan(moments);
  return chain.any_effects() ? SubStepTorque(chain, joints, asked, none, ChainPlant<true>{*this})
                             : SubStepTorque(chain, joints, asked, none, ChainPlant<false>{*this});
}

// The paper's errors move from the motor's angle now, effects from that to which the sub-step
// leads.
Vector7d PandaSim::Impl::OffsetChange(const Vector7d& tau_load, JointMoments& moments) {
  Vector7d change = Vector7d::Zero(), q;
  for (int i = 0; i < 7; ++i) {
    q[i] = data->qpos[panda.qpos[i]];
    moments[i].q += moments[i].h * moments[i].dq;
  }
  episode.chain.MoveErrors({q.data(), 7}, {tau_load.data(), 7}, model->opt.timestep,
                           Values(change));
  episode.chain.MoveEffects(moments, Values(change));
  return change;
}

}  // namespace robostress
