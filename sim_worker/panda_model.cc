#include "sim_worker/panda_model.h"

#include <Eigen/Geometry>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

using ConstMap3 = Eigen::Map<const Eigen::Vector3d>;

absl::StatusOr<int> FindId(const mjModel& model, mjtObj type, const std::string& name) {
  const int id = mj_name2id(&model, type, name.c_str());
  if (id < 0) {
    return absl::NotFoundError(
        absl::StrFormat("the model has no %s '%s'; a scene needs a Panda with robosuite's names "
                        "(see sim_worker/panda_mjcf.h)",
                        mju_type2Str(type), name));
  }
  return id;
}

}  // namespace

absl::StatusOr<PandaModel> PandaModel::Find(const mjModel& model) {
  if (model.opt.timestep != 0.002 || model.opt.integrator != mjINT_EULER) {
    return absl::InvalidArgumentError(
        absl::StrFormat("the model integrates with timestep %g s and integrator %d; 0.002 s and "
                        "Euler (0) are required: 25 "
                        "sub-steps make one control step",
                        model.opt.timestep, model.opt.integrator));
  }
  PandaModel panda;
  for (int i = 0; i < 7; ++i) {
    const std::string joint = absl::StrCat("robot0_joint", i + 1);
    RS_ASSIGN_OR_RETURN(panda.joint[i], FindId(model, mjOBJ_JOINT, joint));
    if (model.jnt_type[panda.joint[i]] != mjJNT_HINGE) {
      return absl::InvalidArgumentError(absl::StrCat("joint '", joint, "' is not a hinge"));
    }
    panda.qpos[i] = model.jnt_qposadr[panda.joint[i]];
    panda.dof[i] = model.jnt_dofadr[panda.joint[i]];
    RS_ASSIGN_OR_RETURN(panda.motor[i],
                        FindId(model, mjOBJ_ACTUATOR, absl::StrCat("robot0_torq_j", i + 1)));
    const double low = model.actuator_ctrlrange[2 * panda.motor[i]];
    panda.torque_limit[i] = model.actuator_ctrlrange[2 * panda.motor[i] + 1];
    if (!(panda.torque_limit[i] > 0) || low != -panda.torque_limit[i]) {
      return absl::InvalidArgumentError(absl::StrFormat(
          "motor robot0_torq_j%d has ctrlrange [%g, %g]; it must be symmetric and not empty", i + 1,
          low, panda.torque_limit[i]));
    }
  }
  for (int i = 0; i < 2; ++i) {
    RS_ASSIGN_OR_RETURN(const int joint,
                        FindId(model, mjOBJ_JOINT, absl::StrCat("gripper0_finger_joint", i + 1)));
    panda.finger_qpos[i] = model.jnt_qposadr[joint];
    panda.finger_dof[i] = model.jnt_dofadr[joint];
    RS_ASSIGN_OR_RETURN(
        panda.finger_motor[i],
        FindId(model, mjOBJ_ACTUATOR, absl::StrCat("gripper0_gripper_finger_joint", i + 1)));
    RS_ASSIGN_OR_RETURN(
        panda.finger_pad[i],
        FindId(model, mjOBJ_GEOM, absl::StrFormat("gripper0_finger%d_pad_collision", i + 1)));
    const double* range = model.actuator_ctrlrange + 2 * panda.finger_motor[i];
    panda.finger_mid[i] = 0.5 * (range[0] + range[1]);
    panda.finger_half[i] = 0.5 * (range[1] - range[0]);
  }
  RS_ASSIGN_OR_RETURN(panda.base_body, FindId(model, mjOBJ_BODY, "robot0_base"));
  RS_ASSIGN_OR_RETURN(panda.hand_body, FindId(model, mjOBJ_BODY, "robot0_right_hand"));
  RS_ASSIGN_OR_RETURN(panda.grip_site, FindId(model, mjOBJ_SITE, "gripper0_grip_site"));
  return panda;
}

void ReadArm(const mjModel& model, const mjData& data, const PandaModel& panda, ArmState& arm) {
  arm.p_tool = ConstMap3(data.site_xpos + 3 * panda.grip_site);
  arm.R_tool = Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(data.site_xmat +
                                                                              9 * panda.grip_site);
  for (int i = 0; i < 7; ++i) {
    arm.q[i] = data.qpos[panda.qpos[i]];
    arm.dq[i] = data.qvel[panda.dof[i]];
    const ConstMap3 axis(data.xaxis + 3 * panda.joint[i]);
    const ConstMap3 anchor(data.xanchor + 3 * panda.joint[i]);
    arm.J.block<3, 1>(0, i) = axis.cross(arm.p_tool - anchor);
    arm.J.block<3, 1>(3, i) = axis;
  }
  // Row i of MuJoCo's sparse mass matrix holds dof i and then its ancestors.
  arm.M.setZero();
  for (int i = 0; i < 7; ++i) {
    int address = model.dof_Madr[panda.dof[i]];
    for (int dof = panda.dof[i]; dof >= 0; dof = model.dof_parentid[dof], ++address) {
      for (int j = 0; j <= i; ++j) {
        if (panda.dof[j] == dof) arm.M(i, j) = arm.M(j, i) = data.qM[address];
      }
    }
  }
}

Vector7d GravityTorque(const mjModel& model, const mjData& data, const PandaModel& panda) {
  return GravityTorque(model, data, panda, ConstMap3(model.opt.gravity));
}

Vector7d GravityTorque(const mjModel& model, const mjData& data, const PandaModel& panda,
                       const Eigen::Vector3d& gravity) {
  Vector7d g;
  for (int i = 0; i < 7; ++i) {
    const int body = model.jnt_bodyid[panda.joint[i]];
    const ConstMap3 axis(data.xaxis + 3 * panda.joint[i]);
    const ConstMap3 anchor(data.xanchor + 3 * panda.joint[i]);
    const ConstMap3 com(data.subtree_com + 3 * body);
    g[i] = -model.body_subtreemass[body] * axis.dot((com - anchor).cross(gravity));
  }
  return g;
}

}  // namespace robostress
