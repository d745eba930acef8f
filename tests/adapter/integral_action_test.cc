#include "adapter/integral_action.h"

#include <gtest/gtest.h>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "tests/adapter/disturbed_arm.h"

namespace robostress {
namespace {

using Vector6 = NominalArm::Vector6;

MethodOptions Method(const std::vector<std::string>& overrides = {}) {
  std::vector<std::string> all = {"integral_rate=0.1", "integral_axes=all"};
  all.insert(all.end(), overrides.begin(), overrides.end());
  return *MakeMethod("ours_integral", all);
}

IntegralAction Make(const MethodOptions& method) {
  return IntegralAction(*method.Find<IntegralOptions>(), ResidualOptionsOf(method), {});
}

void Drive(IntegralAction& integral, DisturbedArm& arm, const Vector6& command, int chunks) {
  for (int i = 0; i < chunks; ++i) integral.Observe(arm.Execute(command, integral.estimate()));
}

const Vector6 kCommand = (Vector6() << 0.2, -0.1, 0.05, 0.02, 0, -0.04).finished();
const Vector6 kDisturbance = (Vector6() << 0, 0.05, -0.3, 0.03, -0.02, 0).finished();

TEST(IntegralAction, FindsAConstantDisturbanceAndTheArmDoesWhatAnUndisturbedOneDoes) {
  IntegralAction integral = Make(Method());
  DisturbedArm arm(1, kDisturbance);
  Drive(integral, arm, kCommand, 40);
  EXPECT_LT((integral.estimate() - kDisturbance).cwiseAbs().maxCoeff(), 2e-3);
  EXPECT_LT((arm.last_motion() - 0.267 * kCommand).cwiseAbs().maxCoeff(), 1e-3);
}

TEST(IntegralAction, StandsStillWhereTheArmIsNominal) {
  IntegralAction integral = Make(Method());
  DisturbedArm arm(1, Vector6::Zero());
  for (const double scale : {1.0, -0.5, 3.0, 0.0}) Drive(integral, arm, scale * kCommand, 5);
  EXPECT_LT(integral.estimate().cwiseAbs().maxCoeff(), 1e-6);
}

TEST(IntegralAction, MakesUpForALowerGain) {
  IntegralAction integral = Make(Method());
  DisturbedArm arm(0.7, Vector6::Zero());
  Drive(integral, arm, kCommand, 60);
  EXPECT_LT((kCommand - integral.estimate() - kCommand / 0.7).cwiseAbs().maxCoeff(), 2e-3);
}

TEST(IntegralAction, KeepsItsBound) {
  IntegralAction integral = Make(Method({"integral_limit=0.1"}));
  DisturbedArm arm(1, kDisturbance);
  Drive(integral, arm, kCommand, 40);
  EXPECT_EQ(integral.estimate()[2], -0.1);
  EXPECT_NEAR(integral.estimate()[1], 0.05, 2e-3);
}

TEST(IntegralAction, EstimatesTheAxesItIsAskedFor) {
  IntegralAction integral = Make(Method({"integral_axes=translation"}));
  DisturbedArm arm(1, kDisturbance);
  Drive(integral, arm, kCommand, 40);
  EXPECT_NEAR(integral.estimate()[2], -0.3, 2e-3);
  EXPECT_EQ(integral.estimate().tail<3>(), Eigen::Vector3d::Zero());
}

TEST(IntegralAction, TakesLittleForNothingWithAThreshold) {
  IntegralAction integral = Make(Method({"integral_threshold=0.1"}));
  EXPECT_EQ(integral.correction(), Vector6::Zero());
  DisturbedArm arm(1, kDisturbance);
  Drive(integral, arm, kCommand, 40);
  EXPECT_NEAR(integral.estimate()[1], 0.05, 2e-3) << "what is estimated stays as it is";
  EXPECT_EQ(integral.correction()[1], 0);
  EXPECT_NEAR(integral.correction()[2], 0.3 - 0.01 / 0.3, 2e-3);
}

TEST(IntegralAction, MaskedStepsMoveTheNominalArmAndNotTheEstimate) {
  IntegralAction integral = Make(Method());
  DisturbedArm arm(1, kDisturbance);
  ExecutedChunk chunk = arm.Execute(kCommand, Vector6::Zero());
  chunk.masked.assign(5, true);
  integral.Observe(chunk);
  EXPECT_EQ(integral.estimate(), Vector6::Zero());
  EXPECT_GT(integral.State().tail<6>().norm(), 0);
}

TEST(IntegralAction, AnEpisodeBeginsAtRestAndWithTheEstimateOnlyWhereItIsCarried) {
  for (const bool carry : {false, true}) {
    IntegralAction integral =
        Make(Method({carry ? "integral_carry=true" : "integral_carry=false"}));
    DisturbedArm arm(1, kDisturbance);
    Drive(integral, arm, kCommand, 4);
    const Vector6 before = integral.estimate();
    integral.StartEpisode();
    EXPECT_EQ(integral.estimate(), carry ? before : Vector6(Vector6::Zero()));
    EXPECT_EQ(integral.State().tail<12>().norm(), 0);
  }
}

TEST(IntegralAction, GoesOnFromItsStateBitForBit) {
  IntegralAction straight = Make(Method()), kept = Make(Method());
  DisturbedArm arm(0.8, kDisturbance);
  Drive(straight, arm, kCommand, 7);
  kept.SetState(straight.State());
  DisturbedArm other = arm;
  Drive(straight, arm, kCommand, 7);
  Drive(kept, other, kCommand, 7);
  EXPECT_EQ(straight.State(), kept.State());
}

}  // namespace
}  // namespace robostress
