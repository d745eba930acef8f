#include "adapter/panda_dynamics.h"

#include <gtest/gtest.h>

#include <Eigen/Eigenvalues>
#include <cmath>
#include <string>
#include <vector>

#include "adapter/command_correction.h"
#include "adapter/envelope.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "adapter/pseudo_target.h"
#include "tests/adapter/disturbed_arm.h"

namespace robostress {
namespace {

using Vector6 = NominalArm::Vector6;

NominalArmOptions Panda() {
  NominalArmOptions options;
  options.panda_dynamics = true;
  return options;
}

// Swings about its base, bent otherwise than at home.
RobotState Swinging() {
  RobotState robot;
  robot.q = Eigen::VectorXd::Constant(7, 0.5);
  robot.q[3] = -1.5;
  robot.dq = 0.4 * Eigen::VectorXd::Unit(7, 0);
  return robot;
}

// Beside the simulator's model: PandaSim.ThePandasDynamicsAreThoseOfItsModel.
TEST(PandaDynamics, AreDefinedInAnyPosture) {
  const Eigen::Matrix<double, 6, 6> home = PandaDynamics::At({}, {}).coupling;
  srand(7);
  for (int i = 0; i < 200; ++i) {
    const Eigen::VectorXd q = 2 * Eigen::VectorXd::Random(7);
    const Eigen::VectorXcd values = PandaDynamics::At(q, {}).coupling.eigenvalues();
    EXPECT_LT(values.imag().cwiseAbs().maxCoeff(), 1e-6);
    EXPECT_GE(values.real().minCoeff(), -1e-6);
    EXPECT_LE(values.real().maxCoeff(), 2 + 1e-6);
  }
  EXPECT_EQ(PandaDynamics::At(Eigen::VectorXd::Zero(6), {}).coupling, home);
  EXPECT_EQ(PandaDynamics::At(Eigen::VectorXd::Constant(7, NAN), {}).coupling, home);
  EXPECT_TRUE(PandaDynamics::At(Eigen::VectorXd::Zero(7), {}).coupling.allFinite());
  EXPECT_EQ(PandaDynamics::At(Swinging().q, {}).drift, Vector6::Zero());
  for (const double dq : {4.1, -1e300, static_cast<double>(NAN), static_cast<double>(INFINITY)}) {
    const PandaDynamics at = PandaDynamics::At(Swinging().q, dq * Eigen::VectorXd::Unit(7, 2));
    EXPECT_EQ(at.drift, Vector6::Zero()) << dq;
    EXPECT_NE(at.coupling, home);
  }
}

TEST(PandaDynamics, CarryTheNominalArm) {
  const RobotState robot = Swinging();
  const PandaDynamics at = PandaDynamics::At(robot.q, robot.dq);
  EXPECT_GT(at.drift.head<3>().norm(), 0.05);
  NominalArmOptions options = Panda();
  options.control_period_s = 0.02;
  options.sub_steps = 1;  // x = h^2 (C kp a + d)
  options.translation_scale = 0.02;
  options.rotation_scale = 0.3;
  const Vector6 scale = (Vector6() << 0.02, 0.02, 0.02, 0.3, 0.3, 0.3).finished();
  for (int axis = 0; axis < 6; ++axis) {
    const Vector6 moved = NominalArm(options).Step(0.4 * Vector6::Unit(axis), robot);
    const Vector6 expected =
        0.02 * 0.02 * (scale[axis] * 150 * 0.4 * at.coupling.col(axis) + at.drift);
    EXPECT_LT((moved.cwiseProduct(scale) - expected).norm(), 1e-12) << axis;
  }
  options.panda_dynamics = false;
  EXPECT_EQ(NominalArm(options).Step(Vector6::Zero(), robot), Vector6::Zero());
}

// Twice as stiff along the coupling, an arm asked once a second still settles.
TEST(PandaDynamics, LeaveASlowClientsArmStable) {
  NominalArmOptions options = Panda();
  options.control_period_s = 1;
  NominalArm arm(options);
  for (int i = 0; i < 100; ++i) {
    const Vector6 moved = arm.Step((i % 2 == 0 ? 0.5 : -0.5) * Vector6::Ones(), Swinging());
    ASSERT_LT((moved.cwiseAbs().array() - 0.5).abs().maxCoeff(), 0.1) << i;
  }
}

// It shifts while it turns; what it was told, it does.
TEST(PandaDynamics, LeadToTheSameGoal) {
  NominalArmOptions options = Panda();
  options.goal_reference = GoalReference::kDesired;
  NominalArm arm(options);
  const Vector6 turn = 0.5 * Vector6::Unit(4);
  Vector6 moved = arm.Step(turn);
  EXPECT_LT(moved[0], -0.1);
  for (int i = 0; i < 200; ++i) moved += arm.Step(Vector6::Zero());
  EXPECT_LT((moved - turn).norm(), 1e-6);
}

// A healthy Panda that turns and swings, seen by every way that compares with a nominal arm.
class HealthyPanda : public testing::TestWithParam<std::vector<std::string>> {
 protected:
  // Largest correction of a translation that it gets.
  static double Corrected(bool known) {
    std::vector<std::string> options = GetParam();  // preset, then options
    const std::string preset = options[0];
    options[0] = known ? "panda_dynamics=true" : "panda_dynamics=false";
    const MethodOptions method = *MakeMethod(preset, options);
    EXPECT_TRUE(method.Check().ok()) << method.Check();
    const SessionSetting setting;
    CommandCorrection correction(method, ResidualOf(setting, method),
                                 NominalArmOf(setting, method));
    DisturbedArm arm(1, Vector6::Zero(), Panda(), Swinging());
    double largest = 0;
    for (int i = 0; i < 6; ++i) {
      correction.Observe(arm.Execute((i < 3 ? 0.5 : -0.4) * Vector6::Unit(4), Vector6::Zero()));
      largest = std::max(largest, correction.Value().head<3>().cwiseAbs().maxCoeff());
    }
    return largest;
  }
};

TEST_P(HealthyPanda, IsLeftAloneWhereItsDynamicsAreKnown) {
  EXPECT_LT(Corrected(true), 1e-6);
  EXPECT_GT(Corrected(false), 0.005);
}

INSTANTIATE_TEST_SUITE_P(
    Ways, HealthyPanda,
    testing::Values(std::vector<std::string>{"ours_panda", "following_threshold=0",
                                             "integral_threshold=0"},
                    std::vector<std::string>{"ours_integral"},
                    std::vector<std::string>{"base", "calibrator_memory=100"}));

// What an arm would have done alone is reckoned in the posture of each step.
TEST(PandaDynamics, ReachTheEnvelope) {
  Envelope envelope({.share = 0.2}, {}, Panda());
  NominalArm arm(Panda());
  DisturbedArm robot(1, Vector6::Zero(), Panda(), Swinging());
  const ExecutedChunk chunk = robot.Execute(0.5 * Vector6::Unit(4), Vector6::Zero(), 7);
  envelope.Observe(chunk);
  for (const ExecutedStep& step : chunk.steps)
    arm.Step(step.sent_command.head<6>().cast<double>(), step.before);
  EXPECT_EQ(envelope.State().tail<6>(), arm.state().velocity);
}

TEST(PandaDynamics, ReachTheNominalTarget) {
  const MethodOptions method = *MakeMethod("ours_nominal", {"panda_dynamics=true"});
  ASSERT_TRUE(method.Check().ok()) << method.Check();
  const SessionSetting setting;
  NominalArm arm(NominalArmOf(setting, method));
  DisturbedArm robot(1, Vector6::Zero(), Panda(), Swinging());
  const absl::StatusOr<Eigen::MatrixXd> residual =
      ReferencedResidual(robot.Execute(0.5 * Vector6::Unit(4), Vector6::Zero()), method.target,
                         ResidualOf(setting, method), {}, &arm);
  ASSERT_TRUE(residual.ok()) << residual.status();
  EXPECT_LT(residual->leftCols(3).cwiseAbs().maxCoeff(), 1e-6);
}

}  // namespace
}  // namespace robostress
