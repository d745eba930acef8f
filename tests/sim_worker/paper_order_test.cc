// The paper's injection (sec:supp_injection) written down once more, plainly and on MuJoCo's own
// functions, against the simulator's reference stepping: the same sub-step order, the same torques,
// the same offsets.
#include <gtest/gtest.h>

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <unsupported/Eigen/MatrixFunctions>

#include "tests/sim_worker/test_scene.h"

namespace robostress {
namespace {

using Vector7 = Eigen::Matrix<double, 7, 1>;
using RowMajor6x7 = Eigen::Matrix<double, 6, 7, Eigen::RowMajor>;

// Arm joints are the model's first seven degrees of freedom in the test scene.
class PlainSimulator {
 public:
  PlainSimulator(SharedModel model, const Scenario& scenario)
      : m_(std::move(model)),
        d_(mj_makeData(m_.get())),
        rest_(mj_makeData(m_.get())),
        scenario_(scenario) {
    site_ = mj_name2id(m_.get(), mjOBJ_SITE, "gripper0_grip_site");
    q0_ = PandaHome();
  }
  ~PlainSimulator() {
    mj_deleteData(d_);
    mj_deleteData(rest_);
  }

  void Reset(const std::vector<double>& qpos) {
    std::copy(qpos.begin(), qpos.end(), d_->qpos);
    mj_forward(m_.get(), d_);
    goal_position_ = Position();
    goal_rotation_ = Rotation();
    for (int j = 0; j < 7; ++j) link_[j] = qpos[j];
  }

  void ControlStep(const Eigen::Vector3d& command, double gripper, int step) {
    mj_forward(m_.get(), d_);
    goal_position_ = Position() + 0.05 * command;
    for (int i = 0; i < 25; ++i) SubStep(gripper, FactorsAt(scenario_, step / 220.0, 0));
  }

  const double* qpos() const { return d_->qpos; }

 private:
  Eigen::Vector3d Position() const {
    return Eigen::Map<const Eigen::Vector3d>(d_->site_xpos + 3 * site_);
  }
  Eigen::Matrix3d Rotation() const {
    return Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>>(d_->site_xmat +
                                                                          9 * site_);
  }

  // robosuite's OSC_POSE as its Python is written, with explicit inverses.
  Vector7 ControllerTorque() const {
    const int nv = m_->nv;
    Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor> full(nv, nv), jac(6, nv);
    mj_fullM(m_.get(), full.data(), d_->qM);
    mj_jacSite(m_.get(), d_, jac.data(), jac.data() + 3 * nv, site_);
    const Eigen::Matrix<double, 7, 7> M = full.topLeftCorner<7, 7>(), M_inv = M.inverse();
    const RowMajor6x7 J = jac.leftCols<7>();
    const Eigen::VectorXd twist = jac * Eigen::Map<const Eigen::VectorXd>(d_->qvel, nv);
    const Eigen::Matrix3d R = Rotation();
    Eigen::Vector3d e_rotation = Eigen::Vector3d::Zero();
    for (int i = 0; i < 3; ++i) e_rotation += 0.5 * R.col(i).cross(goal_rotation_.col(i));
    const double kd = 2 * std::sqrt(150.0);
    const Eigen::Vector3d F = 150 * (goal_position_ - Position()) - kd * twist.head<3>();
    const Eigen::Vector3d T = 150 * e_rotation - kd * twist.tail<3>();
    const Eigen::MatrixXd Jp = J.topRows<3>(), Jr = J.bottomRows<3>();
    const Eigen::MatrixXd Lp = (Jp * M_inv * Jp.transpose()).inverse(),
                          Lr = (Jr * M_inv * Jr.transpose()).inverse();
    const Eigen::MatrixXd L = (J * M_inv * J.transpose()).inverse();
    Eigen::VectorXd wrench(6);
    wrench << Lp * F, Lr * T;
    const Vector7 q = Eigen::Map<const Vector7>(d_->qpos), dq = Eigen::Map<const Vector7>(d_->qvel);
    const Eigen::MatrixXd N = Eigen::MatrixXd::Identity(7, 7) - M_inv * J.transpose() * L * J;
    return J.transpose() * wrench + Eigen::Map<const Vector7>(d_->qfrc_bias) +
           N.transpose() * M * (10 * (q0_ - q) - 2 * std::sqrt(10.0) * dq);
  }

  // Bias torque of the same positions at zero velocity.
  Vector7 GravityTorque() {
    std::copy(d_->qpos, d_->qpos + m_->nq, rest_->qpos);
    mju_zero(rest_->qvel, m_->nv);
    mj_forward(m_.get(), rest_);
    return Eigen::Map<const Vector7>(rest_->qfrc_bias);
  }

  void SubStep(double gripper, const std::vector<SeverityFactors>& w) {
    mj_forward(m_.get(), d_);
    Vector7 tau = ControllerTorque();
    const Vector7 g = GravityTorque();
    const double limit[7] = {80, 80, 80, 80, 80, 12, 12};
    for (int j = 0; j < 7; ++j) {
      const JointErrorParameters& p = NominalPandaErrors()[j];
      const double dq = d_->qvel[j], sign = dq > 0 ? 1 : dq < 0 ? -1 : 0;
      const double friction =
          -sign * (p.Fc + (p.Fs - p.Fc) * std::exp(-std::pow(dq / p.vs, 2))) - p.sigma_v * dq;
      if (scenario_.friction_on) tau[j] += w[j].friction * friction;
      if (scenario_.gravity_on) tau[j] += w[j].gravity * p.beta * g[j];
      tau[j] = std::clamp(tau[j], -limit[j], limit[j]);
    }
    gripper_ = std::clamp(gripper_ - 0.01 * gripper, -1.0, 1.0);
    for (int j = 0; j < 7; ++j) d_->ctrl[j] = tau[j];
    d_->ctrl[7] = 0.02 + 0.02 * gripper_;
    d_->ctrl[8] = -0.02 - 0.02 * gripper_;
    for (int j = 0; j < 7; ++j) {
      const JointErrorParameters& p = NominalPandaErrors()[j];
      const double motor = d_->qpos[j] - offset_[j], B = w[j].backlash * p.B;
      if (motor - link_[j] > B) {
        link_[j] = motor - B;
      } else if (motor - link_[j] < -B) {
        link_[j] = motor + B;
      }
      const double K = p.K / w[j].compliance, D = p.D / std::sqrt(w[j].compliance);
      // (deflection, rate, 1) obeys a linear equation while the load is constant.
      Eigen::Matrix3d A;
      A << 0, 1, 0, -K / p.M_eff, -D / p.M_eff, -tau[j] / p.M_eff, 0, 0, 0;
      const Eigen::Vector3d next = (0.002 * A).exp() * Eigen::Vector3d(deflection_[j], rate_[j], 1);
      deflection_[j] = next[0];
      rate_[j] = next[1];
      const double offset = (scenario_.backlash_on ? link_[j] - motor : 0) +
                            (scenario_.compliance_on ? deflection_[j] : 0);
      d_->qpos[j] += offset - offset_[j];
      offset_[j] = offset;
    }
    mj_step(m_.get(), d_);
  }

  const SharedModel m_;
  mjData* const d_;
  mjData* const rest_;
  const Scenario scenario_;
  int site_;
  Vector7 q0_;
  Eigen::Vector3d goal_position_;
  Eigen::Matrix3d goal_rotation_;
  double gripper_ = 0;
  std::array<double, 7> link_{}, offset_{}, deflection_{}, rate_{};
};

class PaperOrder : public testing::TestWithParam<const char*> {};

TEST_P(PaperOrder, ReferenceSteppingIsThePapersInjection) {
  SimOptions options;
  options.stepping = Stepping::kReference;
  auto sim = MakeTestSim(options);
  UseScenario(*sim, GetParam());
  const std::vector<double> home = HomeState(*sim);
  ASSERT_TRUE(sim->Reset(home, PandaHome()).ok());
  PlainSimulator plain(CompileModel("plain", ComposePandaScene(TestScene())).value(),
                       MakeScenario(GetParam(), 5).value());
  plain.Reset(home);
  for (int step = 0; step < 12; ++step) {
    const Eigen::Vector3d u(0.6 * std::sin(0.9 * step), 0.7,
                            -0.4 * std::cos(0.9 * step));  // reverses directions
    ASSERT_TRUE(sim->Step(Command(u.x(), u.y(), u.z(), -1)).ok());
    plain.ControlStep(u.cast<float>().cast<double>(), -1, step);
    // The two differ by rounding: 9e-16 at most when this was written.
    for (int j = 0; j < 9; ++j) {
      ASSERT_NEAR(sim->data().qpos[j], plain.qpos()[j], 1e-12)
          << "joint " << j + 1 << " after step " << step;
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Scenarios, PaperOrder,
                         testing::Values("clean", "nominal", "isolated_stribeck",
                                         "isolated_gravity", "isolated_backlash",
                                         "isolated_compliance", "thermal_drift_backlash",
                                         "aged_joint_uniform"));

}  // namespace
}  // namespace robostress
