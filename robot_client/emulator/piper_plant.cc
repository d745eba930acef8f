#include "robot_client/emulator/piper_plant.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>

#include "absl/strings/str_cat.h"
#include "common/joint_errors/friction.h"
#include "common/status_macros.h"

namespace robostress::piper {
namespace {

using ConstMap3 = Eigen::Map<const Eigen::Vector3d>;
constexpr double kRestFriction = 50;  // [Nm], more than the arm's weight

using Matrix6 = Eigen::Matrix<double, kJoints, kJoints, Eigen::RowMajor>;

// The only place where MuJoCo compiles: through a virtual file system, errors as text.
absl::StatusOr<mjModel*> Compile(const std::string& xml) {
  const auto files = std::make_unique<mjVFS>();
  mj_defaultVFS(files.get());
  if (mj_makeEmptyFileVFS(files.get(), "piper.xml", static_cast<int>(xml.size())) != 0)
    return absl::ResourceExhaustedError("the Piper's scene does not fit MuJoCo's file system");
  std::copy(xml.begin(), xml.end(),
            static_cast<char*>(files->filedata[mj_findFileVFS(files.get(), "piper.xml")]));
  char error[1000] = "";
  mjModel* model = mj_loadXML("piper.xml", files.get(), error, sizeof error);
  mj_deleteVFS(files.get());
  if (model == nullptr)
    return absl::InvalidArgumentError(absl::StrCat("MuJoCo refuses the Piper's scene: ", error));
  return model;
}

}  // namespace

absl::StatusOr<std::unique_ptr<PiperPlant>> PiperPlant::Create(const std::string& scene_xml,
                                                               const WearProfile& profile) {
  std::unique_ptr<PiperPlant> plant(new PiperPlant);
  RS_ASSIGN_OR_RETURN(mjModel* const model, Compile(scene_xml));
  plant->model_.reset(model);
  plant->data_.reset(mj_makeData(model));
  RS_RETURN_IF_ERROR(plant->FindNames());
  Scenario scenario;
  scenario.name = profile.name;
  scenario.effects = profile.effects;
  plant->effects_.SetScenario(scenario);
  plant->motor_encoders_ = profile.motor_encoders;
  plant->Reset({}, 0);
  return plant;
}

absl::Status PiperPlant::FindNames() {
  const auto find = [&](int type, const std::string& name) -> absl::StatusOr<int> {
    const int id = mj_name2id(model_.get(), type, name.c_str());
    if (id >= 0) return id;
    return absl::NotFoundError(absl::StrCat("the scene has no '", name,
                                            "'; a Piper's names are in emulator/piper_mjcf.h"));
  };
  for (int i = 0; i < kJoints; ++i) {
    RS_ASSIGN_OR_RETURN(joint_[i], find(mjOBJ_JOINT, absl::StrCat("piper_joint", i + 1)));
    qpos_[i] = model_->jnt_qposadr[joint_[i]];
    dof_[i] = model_->jnt_dofadr[joint_[i]];
  }
  for (int i = 0; i < 2; ++i) {
    RS_ASSIGN_OR_RETURN(const int finger, find(mjOBJ_JOINT, absl::StrCat("piper_finger", i + 1)));
    finger_qpos_[i] = model_->jnt_qposadr[finger];
    finger_dof_[i] = model_->jnt_dofadr[finger];
  }
  payload_ = mj_name2id(model_.get(), mjOBJ_BODY, "piper_payload");
  if (model_->opt.timestep != kStep_s)
    return absl::InvalidArgumentError(
        absl::StrCat("the scene's timestep is ", model_->opt.timestep, " s, expected ", kStep_s));
  return absl::OkStatus();
}

// g_j = a_j . ((c_j - o_j) x (-m_j gravity)) of the subtree of joint j: mass m_j, centre c_j, axis
// a_j through o_j.
PiperPlant::Vector6 PiperPlant::HoldingTorque(bool with_payload) const {
  const ConstMap3 gravity(model_->opt.gravity);
  Vector6 torque;
  for (int i = 0; i < kJoints; ++i) {
    const int body = model_->jnt_bodyid[joint_[i]];
    const ConstMap3 axis(data_->xaxis + 3 * joint_[i]), anchor(data_->xanchor + 3 * joint_[i]);
    Eigen::Vector3d moment =
        model_->body_subtreemass[body] * (ConstMap3(data_->subtree_com + 3 * body) - anchor);
    if (!with_payload && payload_ >= 0)
      moment -= model_->body_mass[payload_] * (ConstMap3(data_->xipos + 3 * payload_) - anchor);
    torque[i] = -axis.dot(moment.cross(gravity));
  }
  return torque;
}

EffectStack::Moments PiperPlant::Moments(const Vector6& drive) const {
  EffectStack::Moments moments;
  const Vector6 gravity = HoldingTorque(true);
  for (int i = 0; i < kJoints; ++i) {
    moments[i].t = data_->time;
    moments[i].h = kStep_s;
    moments[i].q = data_->qpos[qpos_[i]] - effects_.offset()[i];
    moments[i].dq = data_->qvel[dof_[i]];
    moments[i].drive = drive[i];
    moments[i].gravity = gravity[i];
  }
  for (int i = 0; i < kJoints; ++i) {
    if (effects_.coupled(i) >= 0) moments[i].coupled_q = moments[effects_.coupled(i)].q;
  }
  moments[kJoints].h = kStep_s;  // the stack's seventh joint does not exist here
  return moments;
}

void PiperPlant::Reset(const JointVector& q, double opening) {
  mj_resetData(model_.get(), data_.get());
  for (int i = 0; i < kJoints; ++i) data_->qpos[qpos_[i]] = q[i];
  for (int i = 0; i < 2; ++i) data_->qpos[finger_qpos_[i]] = 0.5 * opening;
  mj_forward(model_.get(), data_.get());
  EffectStack::Moments moments = Moments(HoldingTorque(true));
  // The joint coordinate carries the transmission's offset already.
  for (int i = 0; i < kJoints; ++i) moments[i].q = q[i];
  effects_.Reset(moments);
  reading_ = {};
  mj_step1(model_.get(), data_.get());
  Read();
}

// Dry friction as the torques that bring the joints to rest within the step where they can. Forces
// of contacts and joint limits are the previous step's.
PiperPlant::Vector6 PiperPlant::WithFriction(const Vector6& torque,
                                             const EffectStack::JointTorques& joints) const {
  Matrix6 M = Matrix6::Zero();
  Vector6 net, dq, forward, backward;
  for (int i = 0; i < kJoints; ++i) {
    // Row i of MuJoCo's sparse mass matrix holds dof i and then its ancestors.
    int address = model_->dof_Madr[dof_[i]];
    for (int dof = dof_[i]; dof >= 0; dof = model_->dof_parentid[dof], ++address) {
      for (int j = 0; j <= i; ++j) {
        if (dof_[j] == dof) M(i, j) = M(j, i) = data_->qM[address];
      }
    }
    M(i, i) += joints.inertia[i];
    dq[i] = data_->qvel[dof_[i]];
    net[i] = torque[i] + data_->qfrc_passive[dof_[i]] + data_->qfrc_constraint[dof_[i]] -
             data_->qfrc_bias[dof_[i]];
    const double rest = parked_ ? kRestFriction : 0;
    forward[i] = std::max(0.0, joints.dry[i].forward) + rest;
    backward[i] = std::max(0.0, joints.dry[i].backward) + rest;
  }
  const Matrix6 M_inverse = Eigen::LLT<Matrix6>(M).solve(Matrix6::Identity());
  const Matrix6 velocity_per_torque = kStep_s * M_inverse;
  const Vector6 v_free = dq + velocity_per_torque * net;
  Vector6 friction;
  StickTorques({v_free.data(), kJoints}, {velocity_per_torque.data(), kJoints * kJoints},
               {forward.data(), kJoints}, {backward.data(), kJoints}, {friction.data(), kJoints});
  const Vector6 acceleration = M_inverse * (net + friction);
  return torque + friction - joints.inertia.head<kJoints>().cwiseProduct(acceleration);
}

void PiperPlant::Step(const JointVector& motor_torque, double finger_force) {
  // The position stage of the step on the way is done: Read left kinematics up to date.
  Vector6 asked;
  for (int i = 0; i < kJoints; ++i)
    asked[i] = std::clamp(motor_torque[i], -kTorqueLimit[i], kTorqueLimit[i]);
  EffectStack::Moments moments = Moments(asked);
  EffectStack::Vector wide = EffectStack::Vector::Zero();
  wide.head<kJoints>() = asked;
  const Vector6 drive = effects_.Drive(wide, moments).head<kJoints>();
  const EffectStack::JointTorques joints = effects_.Torques(moments);
  const Eigen::Map<const Vector6> push(push_.data());
  const Vector6 torque = WithFriction(drive + joints.torque.head<kJoints>() + push, joints);
  for (int i = 0; i < kJoints; ++i) data_->qfrc_applied[dof_[i]] = torque[i];
  for (int i = 0; i < 2; ++i) data_->qfrc_applied[finger_dof_[i]] = finger_force + finger_push_;
  mj_step2(model_.get(), data_.get());
  const EffectStack::Vector before = effects_.offset();
  for (int i = 0; i < kJoints; ++i) moments[i].q = data_->qpos[qpos_[i]] - before[i];
  const EffectStack::Vector change = effects_.OffsetChange(moments);
  for (int i = 0; i < kJoints; ++i) {
    data_->qpos[qpos_[i]] += change[i];
    reading_.torque[i] = drive[i];
  }
  reading_.grip_force = finger_force;
  mj_step1(model_.get(), data_.get());
  Read();
}

void PiperPlant::Read() {
  const Vector6 gravity = HoldingTorque(false);
  for (int i = 0; i < kJoints; ++i) {
    const double before_encoder = motor_encoders_ ? effects_.offset()[i] : 0;
    reading_.q[i] = effects_.Reading(i, data_->qpos[qpos_[i]] - before_encoder);
    reading_.dq[i] = effects_.ReadingSlope(i) * data_->qvel[dof_[i]];
    reading_.gravity[i] = gravity[i];
  }
  reading_.opening = data_->qpos[finger_qpos_[0]] + data_->qpos[finger_qpos_[1]];
  reading_.opening_speed = data_->qvel[finger_dof_[0]] + data_->qvel[finger_dof_[1]];
}

JointVector PiperPlant::link_angles() const {
  JointVector q;
  for (int i = 0; i < kJoints; ++i) q[i] = data_->qpos[qpos_[i]];
  return q;
}

}  // namespace robostress::piper
