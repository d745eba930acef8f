// The gravity residual over random poses against g_j(q) = -sum_b m_b gravity . J_b,j with centres
// of mass and their Jacobians from a chain product of our own; MuJoCo gives constants of the model
// only.
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <vector>

#include "common/joint_errors/joint_chain.h"
#include "common/random.h"
#include "sim_worker/panda_model.h"
#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

using ConstMap3 = Eigen::Map<const Eigen::Vector3d>;

// A hinge's axis and a point on it, world frame.
struct Axis {
  int body;
  Eigen::Vector3d direction, anchor;
};

Eigen::Isometry3d BodyInParent(const mjModel& m, int body) {
  const double* q = m.body_quat + 4 * body;
  return Eigen::Translation3d(ConstMap3(m.body_pos + 3 * body)) *
         Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
}

// World poses of every body; `axes` [joints] of the hinges. Hinges and slides only.
std::vector<Eigen::Isometry3d> Chain(const mjModel& m, const double* qpos,
                                     std::vector<Axis>& axes) {
  std::vector<Eigen::Isometry3d> pose(m.nbody, Eigen::Isometry3d::Identity());
  for (int b = 1; b < m.nbody; ++b) {
    pose[b] = pose[m.body_parentid[b]] * BodyInParent(m, b);
    for (int j = m.body_jntadr[b]; j >= 0 && j < m.body_jntadr[b] + m.body_jntnum[b]; ++j) {
      const ConstMap3 axis(m.jnt_axis + 3 * j), point(m.jnt_pos + 3 * j);
      const double q = qpos[m.jnt_qposadr[j]] - m.qpos0[m.jnt_qposadr[j]];
      if (m.jnt_type[j] == mjJNT_SLIDE) pose[b] = pose[b] * Eigen::Translation3d(q * axis);
      if (m.jnt_type[j] != mjJNT_HINGE) continue;
      axes[j] = {b, pose[b].linear() * axis, pose[b] * point};
      pose[b] = pose[b] * Eigen::Translation3d(point) * Eigen::AngleAxisd(q, axis) *
                Eigen::Translation3d(-point);
    }
  }
  return pose;
}

bool Carries(const mjModel& m, int joint_body, int body) {
  while (body > joint_body) body = m.body_parentid[body];
  return body == joint_body;
}

// Holding torque of arm joint 1..7 [Nm]; the bodies from `end` on weigh nothing.
Vector7d HoldingTorque(const mjModel& m, const PandaModel& panda, const double* qpos, int end) {
  std::vector<Axis> axes(m.njnt);
  const std::vector<Eigen::Isometry3d> pose = Chain(m, qpos, axes);
  Vector7d g = Vector7d::Zero();
  for (int j = 0; j < 7; ++j) {
    const Axis& axis = axes[panda.joint[j]];
    for (int b = axis.body; b < end; ++b) {
      if (!Carries(m, axis.body, b)) continue;
      const Eigen::Vector3d com = pose[b] * ConstMap3(m.body_ipos + 3 * b);
      const Eigen::Vector3d jacobian = axis.direction.cross(com - axis.anchor);
      g[j] -= m.body_mass[b] * ConstMap3(m.opt.gravity).dot(jacobian);
    }
  }
  return g;
}

class GravityResidualInSim : public ::testing::Test {
 protected:
  void SetUp() override {
    sim_ = MakeTestSim();
    ASSERT_NE(sim_, nullptr);
    panda_ = PandaModel::Find(sim_->model()).value();
  }
  // Arm and fingers anywhere within their ranges.
  std::vector<double> RandomPose(RandomStream& random) const {
    const mjModel& m = sim_->model();
    std::vector<double> qpos(m.qpos0, m.qpos0 + m.nq);
    for (int j = 0; j < 9; ++j) {
      qpos[m.jnt_qposadr[j]] = random.Uniform(m.jnt_range[2 * j], m.jnt_range[2 * j + 1]);
    }
    return qpos;
  }
  Vector7d Computed(const std::vector<double>& qpos) {
    mjData& d = sim_->mutable_data();
    std::copy(qpos.begin(), qpos.end(), d.qpos);
    mj_fwdPosition(&sim_->model(), &d);
    return GravityTorque(sim_->model(), d, panda_);
  }

  std::unique_ptr<PandaSim> sim_;
  PandaModel panda_;
};

TEST_F(GravityResidualInSim, IsBetaTimesTheHoldingTorqueOverRandomPosesAtEveryLevel) {
  const double nominal_beta[7] = {0.05, 0.10, 0.06, 0.10, 0.08, 0.08, 0.05};
  const double factor[5] = {2, 2.5, 3, 3.5, 4};
  std::vector<JointChain> chains;
  for (int level = 1; level <= 5; ++level) {
    chains.emplace_back(7);
    chains.back().SetScenario(MakeScenario("isolated_gravity", level).value(), 1);
  }
  RandomStream random(StreamKey("gravity poses"));
  for (int k = 0; k < 500; ++k) {
    const std::vector<double> qpos = RandomPose(random);
    const Vector7d g = Computed(qpos);
    const Vector7d own = HoldingTorque(sim_->model(), panda_, qpos.data(), sim_->model().nbody);
    for (int level = 1; level <= 5; ++level) {
      std::array<JointMoment, 7> moments;
      for (int j = 0; j < 7; ++j) moments[j].gravity = g[j];
      Vector7d residual = Vector7d::Zero();
      chains[level - 1].AddTorques(moments, {residual.data(), 7});
      for (int j = 0; j < 7; ++j) {
        EXPECT_NEAR(residual[j], factor[level - 1] * nominal_beta[j] * own[j], 1e-10)
            << "pose " << k << " level " << level << " joint " << j + 1;
      }
    }
  }
}

TEST_F(GravityResidualInSim, HoldsTheMassOfTheTool) {
  const mjModel& m = sim_->model();
  double tool = 0;  // hand 0.5, gripper 0.3, two fingers of 0.1 with tips of 0.01 [kg]
  for (int b = panda_.hand_body; b < m.nbody; ++b) {
    if (Carries(m, panda_.hand_body, b)) tool += m.body_mass[b];
  }
  EXPECT_NEAR(tool, 1.02, 1e-12);
  const std::vector<double> qpos = HomeState(*sim_);
  const Vector7d g = Computed(qpos);
  const Vector7d bare = HoldingTorque(m, panda_, qpos.data(), panda_.hand_body);
  // Of home, the tool adds about 1.02 kg at half a metre to the shoulder's torque.
  EXPECT_GT(std::abs(g[1] - bare[1]), 4);
  EXPECT_GT(std::abs(g[3] - bare[3]), 3);
}

}  // namespace
}  // namespace robostress
