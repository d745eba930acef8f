#include "calibration/model/plant.h"

#include <mujoco/mujoco.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/model/model_file.h"
#include "common/status_macros.h"

namespace robostress::calibration {
namespace {

using Vector = Eigen::VectorXd;

struct DataDeleter {
  void operator()(mjData* data) const { mj_deleteData(data); }
};

constexpr double kSlopeStep = 1e-4;     // [rad]
constexpr double kLeastInertia = 1e-9;  // [kg m^2]; a clock's hand has 1e-8

class MujocoPlant : public Plant {
 public:
  struct Joint {
    int id = 0, dof = 0, qpos = 0;
    int payload_body = 0, payload_site = -1;
    bool payload_link = false;  // it hangs at the body's origin, not at its centre of mass
    bool between_rows = false;  // rows stand for the time to the next one, not for an instant
  };

  explicit MujocoPlant(LoadedModel loaded)
      : model_(std::move(loaded.model)),
        data_(mj_makeData(model_.get())),
        payload_link_(std::move(loaded.payload_link)),
        effort_(std::move(loaded.effort)),
        facts_(std::move(loaded.facts)) {}

  absl::Status FindJoints(const Rig& rig) {
    std::vector<std::string> names;
    for (int i = 0; i < model_->njnt; ++i) {
      const char* name = mj_id2name(model_.get(), mjOBJ_JOINT, i);
      names.push_back(name == nullptr ? "(nameless)" : name);
    }
    for (const RigJoint& declared : rig.joints) {
      Joint joint;
      joint.id = mj_name2id(model_.get(), mjOBJ_JOINT, declared.name.c_str());
      if (joint.id < 0)
        return absl::NotFoundError(absl::StrCat(rig.model, ": has no joint '", declared.name,
                                                "'; it has ", absl::StrJoin(names, ", ")));
      const int type = model_->jnt_type[joint.id];
      if (type != mjJNT_HINGE && type != mjJNT_SLIDE)
        return absl::InvalidArgumentError(absl::StrCat(
            rig.model, ": joint '", declared.name, "' is a ball or free joint; hinge or slide"));
      joint.dof = model_->jnt_dofadr[joint.id];
      joint.qpos = model_->jnt_qposadr[joint.id];
      joint.between_rows =
          declared.input == JointInput::kPositionTarget || declared.input == JointInput::kTorque;
      FindPayload(joint);
      joints_.push_back(joint);
      RS_RETURN_IF_ERROR(CheckInertia(rig.model, declared, joint));
    }
    return absl::OkStatus();
  }

  bool single() const override { return model_->nv == 1; }
  bool hinge(int joint) const override {
    return model_->jnt_type[joints_[joint].id] == mjJNT_HINGE;
  }
  double travel(int joint) const override {
    const int id = joints_[joint].id;
    return model_->jnt_limited[id] ? model_->jnt_range[2 * id + 1] - model_->jnt_range[2 * id] : 0;
  }
  PlantPassive passive(int joint) const override {
    const Joint& j = joints_[joint];
    return {model_->dof_armature[j.dof], model_->dof_damping[j.dof],
            model_->dof_frictionloss[j.dof], model_->jnt_stiffness[j.id],
            model_->qpos_spring[j.qpos]};
  }

  double effort_limit(int joint) const override {
    const auto found = effort_.find(mj_id2name(model_.get(), mjOBJ_JOINT, joints_[joint].id));
    return found == effort_.end() ? std::numeric_limits<double>::infinity() : found->second;
  }
  const std::vector<ModelFact>& facts() const override { return facts_; }

  std::vector<PlantRow> Rows(int joint, const MeasuredLog& log) const override {
    if (single()) return {SingleRow(joint)};
    std::vector<PlantRow> rows(log.rows);
    for (int k = 0; k < log.rows; ++k) rows[k] = ArmRow(joint, log, k);
    if (joints_[joint].between_rows)
      for (int k = 0; k + 1 < log.rows; ++k) rows[k].coupling_rise = RiseUntilNext(joint, log, k);
    return rows;
  }

 private:
  void FindPayload(Joint& joint) const {
    const int moved = model_->jnt_bodyid[joint.id];
    const auto below = [&](int body) {
      while (body > 0 && body != moved) body = model_->body_parentid[body];
      return body == moved;
    };
    for (const char* name : kPayloadSites) {
      const int site = mj_name2id(model_.get(), mjOBJ_SITE, name);
      if (site >= 0 && below(model_->site_bodyid[site])) {
        joint.payload_site = site;
        joint.payload_body = model_->site_bodyid[site];
        return;
      }
    }
    const int link =
        payload_link_.empty() ? -1 : mj_name2id(model_.get(), mjOBJ_BODY, payload_link_.c_str());
    joint.payload_link = link > 0 && below(link);
    if (joint.payload_link) joint.payload_body = link;
    for (int body = 1; body < model_->nbody && !joint.payload_link; ++body) {
      if (below(body) && model_->body_mass[body] > 0) joint.payload_body = body;
    }
  }

  absl::Status CheckInertia(const std::string& file, const RigJoint& declared,
                            const Joint& joint) const {
    SetPosture(NeutralPosture());
    const auto armature = declared.parameters.find("armature");
    const double inertia = InertiaRow(joint)[joint.dof] +
                           (armature == declared.parameters.end() ? 0 : armature->second);
    if (inertia >= kLeastInertia) return absl::OkStatus();
    return absl::InvalidArgumentError(absl::StrFormat(
        "%s: joint '%s' moves an inertia of %.3g kg m^2, must be at least %g: give its links "
        "inertials, or the joint parameters: {armature: ...} in the rig",
        file, declared.name, inertia, kLeastInertia));
  }

  void SetPosture(const Vector& qpos) const {
    for (int i = 0; i < model_->nq; ++i) data_->qpos[i] = qpos[i];
    mju_zero(data_->qvel, model_->nv);
    mj_kinematics(model_.get(), data_.get());
    mj_comPos(model_.get(), data_.get());
  }
  // Torque that holds the joint at the posture set, per axis of gravity [Nm / (m/s^2)].
  Eigen::Vector3d HoldingPerAxis(const Joint& joint) const {
    Eigen::Vector3d result;
    std::vector<double> torque(model_->nv);
    const Eigen::Vector3d gravity = Gravity();
    for (int axis = 0; axis < 3; ++axis) {
      mju_zero3(model_->opt.gravity);
      model_->opt.gravity[axis] = 1;
      mj_comVel(model_.get(), data_.get());
      mj_rne(model_.get(), data_.get(), 0, torque.data());
      result[axis] = torque[joint.dof];
    }
    mju_copy3(model_->opt.gravity, gravity.data());
    return result;
  }
  Eigen::Vector3d Gravity() const { return Eigen::Map<const Eigen::Vector3d>(model_->opt.gravity); }
  // Column of the payload point's Jacobian [m/rad].
  Eigen::Vector3d PayloadColumn(const Joint& joint) const {
    std::vector<double> jacobian(3 * model_->nv);
    const double* point = joint.payload_site >= 0 ? data_->site_xpos + 3 * joint.payload_site
                          : joint.payload_link    ? data_->xpos + 3 * joint.payload_body
                                                  : data_->xipos + 3 * joint.payload_body;
    mj_jac(model_.get(), data_.get(), jacobian.data(), nullptr, point, joint.payload_body);
    return {jacobian[joint.dof], jacobian[model_->nv + joint.dof],
            jacobian[2 * model_->nv + joint.dof]};
  }

  // Everything that is linear in gravity, at one posture.
  struct GravityTerms {
    double gravity = 0, payload = 0, tilt[2] = {0, 0};
  };
  GravityTerms TermsAt(const Joint& joint, const Vector& qpos) const {
    SetPosture(qpos);
    const Eigen::Vector3d per_axis = HoldingPerAxis(joint), g = Gravity();
    GravityTerms terms;
    terms.gravity = per_axis.dot(g);
    terms.payload = -PayloadColumn(joint).dot(g);
    // A base that turns by a small angle about an axis sees gravity turn the other way.
    for (int axis = 0; axis < 2; ++axis)
      terms.tilt[axis] = per_axis.dot(-Eigen::Vector3d::Unit(axis).cross(g));
    return terms;
  }

  Vector NeutralPosture() const { return Eigen::Map<const Vector>(model_->qpos0, model_->nq); }

  // M of the posture set; row of the joint, armature included [kg m^2].
  Vector InertiaRow(const Joint& joint) const {
    mj_crb(model_.get(), data_.get());
    std::vector<double> full(static_cast<size_t>(model_->nv) * model_->nv);
    mj_fullM(model_.get(), full.data(), data_->qM);
    return Eigen::Map<const Vector>(full.data() + static_cast<size_t>(joint.dof) * model_->nv,
                                    model_->nv);
  }

  PlantRow SingleRow(int index) const {
    const Joint& joint = joints_[index];
    Vector posture = NeutralPosture();
    const auto at = [&](double q) {
      posture[joint.qpos] = q;
      return TermsAt(joint, posture);
    };
    PlantRow row;
    // a cos q + b sin q + c, from 0, a quarter and half a turn; a slide has only c.
    const GravityTerms zero = at(0), quarter = at(M_PI / 2), half = at(M_PI);
    const bool turns = hinge(index);
    const auto term = [&](double f0, double f1, double f2) {
      const double c = turns ? (f0 + f2) / 2 : f0;
      return turns ? PlantTerm{f0 - c, f1 - c, c} : PlantTerm{0, 0, c};
    };
    row.gravity = term(zero.gravity, quarter.gravity, half.gravity);
    row.payload_gravity = term(zero.payload, quarter.payload, half.payload);
    for (int i = 0; i < 2; ++i)
      row.tilt_gravity[i] = term(zero.tilt[i], quarter.tilt[i], half.tilt[i]);
    at(0);
    row.inertia = InertiaRow(joint)[joint.dof] - model_->dof_armature[joint.dof];
    row.payload_inertia = PayloadColumn(joint).squaredNorm();
    return row;
  }

  PlantRow ArmRow(int index, const MeasuredLog& log, int k) const {
    const Joint& joint = joints_[index];
    Vector posture = NeutralPosture(), velocity = Vector::Zero(model_->nv),
           acceleration = Vector::Zero(model_->nv);
    const int next = joint.between_rows ? std::min(k + 1, log.rows - 1) : k;
    const auto at = [&](const std::vector<double>& channel) {
      return 0.5 * (channel[k] + channel[next]);
    };
    for (size_t i = 0; i < joints_.size(); ++i) {
      posture[joints_[i].qpos] = at(log.joints[i].motion.q);
      velocity[joints_[i].dof] = at(log.joints[i].motion.dq);
      const std::vector<double>& ddq = log.joints[i].motion.ddq;
      acceleration[joints_[i].dof] =
          joint.between_rows ? ddq[k] : 0.5 * (ddq[std::max(0, k - 1)] + ddq[k]);
    }
    PlantRow row;
    row.q_ref = posture[joint.qpos];
    const GravityTerms here = TermsAt(joint, posture);
    row.payload_inertia = PayloadColumn(joint).squaredNorm();
    const Vector inertia = InertiaRow(joint);
    row.inertia = inertia[joint.dof] - model_->dof_armature[joint.dof];
    acceleration[joint.dof] = 0;
    row.coupling = inertia.dot(acceleration) + CoriolisAt(joint, velocity);
    posture[joint.qpos] += kSlopeStep;
    const GravityTerms ahead = TermsAt(joint, posture);
    const auto term = [&](double value, double beside) {
      return PlantTerm{0, (beside - value) / kSlopeStep, value};
    };
    row.gravity = term(here.gravity, ahead.gravity);
    row.payload_gravity = term(here.payload, ahead.payload);
    for (int i = 0; i < 2; ++i) row.tilt_gravity[i] = term(here.tilt[i], ahead.tilt[i]);
    return row;
  }

  // By how much gravity, Coriolis and the other joints' accelerations rise from row k to the next,
  // at the joint's own position halfway [Nm]; 0 where no joint's rise is known.
  double RiseUntilNext(int index, const MeasuredLog& log, int k) const {
    const Joint& joint = joints_[index];
    if (std::all_of(log.joints.begin(), log.joints.end(),
                    [](const JointRecord& other) { return other.motion.rise.empty(); }))
      return 0;
    const auto asked = [&](int row, double end) {
      Vector posture = NeutralPosture(), velocity = Vector::Zero(model_->nv),
             acceleration = Vector::Zero(model_->nv);
      for (size_t i = 0; i < joints_.size(); ++i) {
        const JointMotion& motion = log.joints[i].motion;
        posture[joints_[i].qpos] = motion.q[row];
        velocity[joints_[i].dof] = motion.dq[row];
        acceleration[joints_[i].dof] =
            motion.ddq[k] + (motion.rise.empty() ? 0 : end * motion.rise[k]);
      }
      const JointMotion& own = log.joints[index].motion;
      posture[joint.qpos] = 0.5 * (own.q[k] + own.q[k + 1]);
      acceleration[joint.dof] = 0;
      SetPosture(posture);
      const double gravity = HoldingPerAxis(joint).dot(Gravity());
      return gravity + InertiaRow(joint).dot(acceleration) + CoriolisAt(joint, velocity);
    };
    return asked(k + 1, 0.5) - asked(k, -0.5);
  }

  // Of the posture set [Nm].
  double CoriolisAt(const Joint& joint, const Vector& velocity) const {
    const Eigen::Vector3d gravity = Gravity();
    std::vector<double> torque(model_->nv);
    mju_zero3(model_->opt.gravity);
    mju_copy(data_->qvel, velocity.data(), model_->nv);
    mj_comVel(model_.get(), data_.get());
    mj_rne(model_.get(), data_.get(), 0, torque.data());
    mju_zero(data_->qvel, model_->nv);
    mju_copy3(model_->opt.gravity, gravity.data());
    return torque[joint.dof];
  }

  std::unique_ptr<mjModel, ModelDeleter> model_;
  std::unique_ptr<mjData, DataDeleter> data_;
  std::vector<Joint> joints_;
  std::string payload_link_;
  std::map<std::string, double> effort_;
  std::vector<ModelFact> facts_;
};

}  // namespace

absl::StatusOr<std::unique_ptr<Plant>> Plant::Load(const Rig& rig) {
  RS_ASSIGN_OR_RETURN(LoadedModel loaded, LoadModel(rig));
  auto plant = std::make_unique<MujocoPlant>(std::move(loaded));
  RS_RETURN_IF_ERROR(plant->FindJoints(rig));
  return plant;
}

}  // namespace robostress::calibration
