#include "adapter/residual_calibrator.h"

#include <gtest/gtest.h>

#include <cmath>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "tests/adapter/disturbed_arm.h"

namespace robostress {
namespace {

using Vector6 = NominalArm::Vector6;

ResidualCalibrator Make(double memory = 1000, double limit = 0.5) {
  const MethodOptions method =
      *MakeMethod("base", {absl::StrCat("calibrator_memory=", memory),
                           absl::StrCat("calibrator_limit=", limit), "calibrator_ridge=0.1"});
  return ResidualCalibrator(*method.Find<CalibratorOptions>(), ResidualOptionsOf(method), {});
}

// Here and there, so that the arm stays where it is.
Vector6 Command(int step) {
  return (Vector6() << 0.3 * std::sin(0.2 * step), 0.2 * std::cos(0.13 * step),
          0.1 * std::sin(0.31 * step), 0, 0, 0.05 * std::cos(0.2 * step))
      .finished();
}

// Corrected at every step; returns how far the arm was from a nominal one, over the last half.
double Drive(ResidualCalibrator& calibrator, DisturbedArm& arm, int steps) {
  NominalArm nominal{NominalArmOptions()};
  double squares = 0;
  for (int i = 0; i < steps; ++i) {
    const Vector6 wanted = nominal.Step(Command(i));
    calibrator.Observe(arm.Execute(Command(i), -Vector6(calibrator.correction()), 1));
    if (i >= steps / 2) squares += (arm.last_motion() - wanted).head<3>().squaredNorm();
  }
  return std::sqrt(squares / (steps / 2));
}

const Vector6 kDisturbance = (Vector6() << 0, 0.05, -0.3, 0, 0, 0).finished();

TEST(ResidualCalibrator, TakesOffAConstantDisturbance) {
  ResidualCalibrator learns = Make(), none = Make(1000, 0);
  DisturbedArm arm(1, kDisturbance), left_alone(1, kDisturbance);
  EXPECT_LT(Drive(learns, arm, 600), 0.1 * Drive(none, left_alone, 600));
}

TEST(ResidualCalibrator, LearnsADisturbanceThatDependsOnWhereTheArmIs) {
  // Along y by the place in x: what no constant can take off.
  const auto drive = [](ResidualCalibrator calibrator) {
    DisturbedArm arm(1, Vector6::Zero());
    double squares = 0, x = 0;
    NominalArm nominal{NominalArmOptions()};
    for (int i = 0; i < 800; ++i) {
      arm.set_disturbance(8 * x * Vector6::Unit(1));
      const Vector6 wanted = nominal.Step(Command(i));
      const ExecutedChunk chunk = arm.Execute(Command(i), -Vector6(calibrator.correction()), 1);
      calibrator.Observe(chunk);
      x = chunk.final_state.tool.p_base_tool.x();
      if (i >= 400) squares += std::pow(arm.last_motion()[1] - wanted[1], 2);
    }
    return squares;
  };
  EXPECT_LT(drive(Make()), 0.05 * drive(Make(1000, 0)));
}

TEST(ResidualCalibrator, StandsStillWhereTheArmIsNominal) {
  ResidualCalibrator calibrator = Make();
  DisturbedArm arm(1, Vector6::Zero());
  EXPECT_LT(Drive(calibrator, arm, 200), 1e-6);
  EXPECT_LT(calibrator.correction().norm(), 1e-6);
}

TEST(ResidualCalibrator, KeepsItsBoundAndItsRidgeAtRest) {
  ResidualCalibrator calibrator = Make(20, 0.1);
  DisturbedArm arm(1, kDisturbance);
  for (int i = 0; i < 2000; ++i)
    calibrator.Observe(arm.Execute(Vector6::Zero(), -Vector6(calibrator.correction()), 1));
  EXPECT_NEAR(calibrator.correction()[2], 0.1, 1e-12);
  EXPECT_TRUE(calibrator.Holds(calibrator.State()));
  const Eigen::VectorXd state = calibrator.State();
  const Eigen::Matrix<double, 16, 16> A = state.head<256>().reshaped(16, 16);
  EXPECT_NEAR(A(4, 4), 0.1, 1e-6) << "of a command that was never given";
}

TEST(ResidualCalibrator, LearnsNothingFromAMaskedStepNorFromTheNext) {
  ResidualCalibrator calibrator = Make();
  DisturbedArm arm(1, kDisturbance);
  calibrator.StartEpisode();
  ExecutedChunk chunk = arm.Execute(Command(1), Vector6::Zero(), 3);
  chunk.masked = {false, true, false};
  const Eigen::VectorXd before = calibrator.State();
  calibrator.Observe(chunk);
  EXPECT_LT((calibrator.State().head<304>() - before.head<304>()).norm(), 1e-15);
  EXPECT_EQ(calibrator.State()[304], 1) << "the next one is learned from again";
}

TEST(ResidualCalibrator, AnEpisodeBeginsUncorrectedAndWithWhatWasLearned) {
  ResidualCalibrator calibrator = Make();
  DisturbedArm arm(1, kDisturbance);
  Drive(calibrator, arm, 300);
  const Eigen::VectorXd before = calibrator.State();
  calibrator.StartEpisode();
  EXPECT_EQ(calibrator.correction(), Vector6::Zero());
  EXPECT_EQ(calibrator.State().head<304>(), before.head<304>());
  EXPECT_EQ(calibrator.State().tail<28>().norm(), 0);
}

TEST(ResidualCalibrator, GoesOnFromItsStateBitForBitAndRefusesOthers) {
  ResidualCalibrator straight = Make(), kept = Make();
  DisturbedArm arm(0.8, kDisturbance);
  Drive(straight, arm, 50);
  const Eigen::VectorXd state = straight.State();
  ASSERT_TRUE(kept.Holds(state));
  kept.SetState(state);
  DisturbedArm other = arm;
  Drive(straight, arm, 50);
  Drive(kept, other, 50);
  EXPECT_EQ(straight.State(), kept.State());
  Eigen::VectorXd wrong = state;
  wrong[0] = -1;
  EXPECT_FALSE(kept.Holds(wrong)) << "moments are positive definite";
  EXPECT_FALSE(kept.Holds(state.head(10)));
}

}  // namespace
}  // namespace robostress
