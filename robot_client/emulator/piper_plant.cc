#include "robot_client/emulator/piper_plant.h"

#include <Eigen/Geometry>
#include <algorithm>

#include "absl/strings/str_cat.h"
#include "common/joint_errors/sub_step.h"
#include "common/status_macros.h"
#include "robot_client/piper/kinematics.h"

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
  plant->chain_.SetScenario(scenario, /*horizon=*/1);
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

// At the start of a step, as far as the chain reads them.
std::array<JointMoment, kJoints> PiperPlant::DescribeJoints() const {
  std::array<JointMoment, kJoints> moments;
  Vector6 gravity = Vector6::Zero();
  if (chain_.reads() & kGravityField) gravity = HoldingTorque(true);
  for (int i = 0; i < kJoints; ++i) {
    moments[i].t = data_->time;
    moments[i].h = kStep_s;
    moments[i].q = chain_.MotorAngle(i, data_->qpos[qpos_[i]]);
    moments[i].dq = data_->qvel[dof_[i]];
    moments[i].gravity = gravity[i];
  }
  for (int i = 0; i < kJoints; ++i) {
    const int other = chain_.coupled(i);
    if (other < 0) continue;
    moments[i].coupled_q = moments[other].q;
    moments[i].coupled_dq = moments[other].dq;
    moments[i].coupled_ddq = data_->qacc[dof_[other]];
  }
  return moments;
}

void PiperPlant::Reset(const JointVector& q, double opening) {
  mj_resetData(model_.get(), data_.get());
  for (int i = 0; i < kJoints; ++i) data_->qpos[qpos_[i]] = q[i];
  for (int i = 0; i < 2; ++i) data_->qpos[finger_qpos_[i]] = 0.5 * opening;
  mj_forward(model_.get(), data_.get());
  std::array<JointMoment, kJoints> moments = DescribeJoints();
  const Vector6 holding = HoldingTorque(true);
  for (int i = 0; i < kJoints; ++i) {
    moments[i].q = q[i];
    moments[i].drive = holding[i];
  }
  chain_.Reset(moments);
  reading_ = {};
  mj_step1(model_.get(), data_.get());
  Read();
}

// Forces of contacts and joint limits are the previous step's.
struct PiperPlant::ChainPlant {
  using Inverse = Matrix6;
  const PiperPlant& arm;
  double rest = arm.parked_ ? kRestFriction : 0, h = kStep_s;

  Vector6 Limited(const Vector6& torque) const { return torque; }  // asked for within the limits
  Vector6 Net(const Vector6& torque) const {
    Vector6 net;
    for (int i = 0; i < kJoints; ++i) {
      const int dof = arm.dof_[i];
      net[i] = torque[i] + arm.data_->qfrc_passive[dof] + arm.data_->qfrc_constraint[dof] -
               arm.data_->qfrc_bias[dof];
    }
    return net;
  }
  Matrix6 MassMatrix() const {
    Matrix6 M = Matrix6::Zero();
    // Row i of MuJoCo's sparse mass matrix holds dof i and then its ancestors.
    for (int i = 0; i < kJoints; ++i) {
      int address = arm.model_->dof_Madr[arm.dof_[i]];
      for (int dof = arm.dof_[i]; dof >= 0; dof = arm.model_->dof_parentid[dof], ++address) {
        for (int j = 0; j <= i; ++j) {
          if (arm.dof_[j] == dof) M(i, j) = M(j, i) = arm.data_->qM[address];
        }
      }
    }
    return M;
  }
  Vector6 Velocities() const {
    Vector6 dq;
    for (int i = 0; i < kJoints; ++i) dq[i] = arm.data_->qvel[arm.dof_[i]];
    return dq;
  }
};

void PiperPlant::Step(const JointVector& motor_torque, double finger_force) {
  // The position stage of the step on the way is done: Read left kinematics up to date.
  Vector6 asked;
  for (int i = 0; i < kJoints; ++i)
    asked[i] = std::clamp(motor_torque[i], -TorqueLimit(i), TorqueLimit(i));
  std::array<JointMoment, kJoints> moments = DescribeJoints();
  const Vector6 push = Eigen::Map<const Vector6>(push_.data());
  const Vector6 torque =
      SubStepTorque(chain_, absl::MakeSpan(moments), asked, push, ChainPlant{*this});
  for (int i = 0; i < kJoints; ++i) data_->qfrc_applied[dof_[i]] = torque[i];
  for (int i = 0; i < 2; ++i) data_->qfrc_applied[finger_dof_[i]] = finger_force + finger_push_;
  mj_step2(model_.get(), data_.get());
  for (int i = 0; i < kJoints; ++i) moments[i].q = chain_.MotorAngle(i, data_->qpos[qpos_[i]]);
  Vector6 change = Vector6::Zero();
  chain_.MoveEffects(moments, {change.data(), kJoints});
  for (int i = 0; i < kJoints; ++i) {
    data_->qpos[qpos_[i]] += change[i];
    reading_.torque[i] = moments[i].drive;
  }
  reading_.grip_force = finger_force;
  mj_step1(model_.get(), data_.get());
  Read();
}

void PiperPlant::Read() {
  const Vector6 gravity = HoldingTorque(false);
  for (int i = 0; i < kJoints; ++i) {
    const double before_encoder = motor_encoders_ ? chain_.offset(i) : 0;
    const double seen = data_->qpos[qpos_[i]] - before_encoder;
    reading_.q[i] = chain_.Reading(i, seen);
    reading_.dq[i] = chain_.ReadingSlope(i, seen) * data_->qvel[dof_[i]];
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
