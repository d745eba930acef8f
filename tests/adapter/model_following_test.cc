#include "adapter/model_following.h"

#include <gtest/gtest.h>

#include <cmath>
#include <string>

#include "adapter/command_correction.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "tests/adapter/disturbed_arm.h"

namespace robostress {
namespace {

using Vector6 = NominalArm::Vector6;
constexpr double kSteadyGain = 0.267;  // of a nominal arm

MethodOptions Method(const std::vector<std::string>& overrides = {}) {
  std::vector<std::string> all = {"following_gain=0.3", "following_memory=20",
                                  "following_axes=translation", "following_threshold=0",
                                  "integral_rate=0"};
  all.insert(all.end(), overrides.begin(), overrides.end());
  return *MakeMethod("ours_following", all);
}

ModelFollowing Make(const MethodOptions& method) {
  return ModelFollowing(*method.Find<FollowingOptions>(), ResidualOptionsOf(method), {});
}

TEST(ModelFollowing, FollowsTheUnadaptedPolicyWhereItIsKnown) {
  ModelFollowing with = Make(Method()), without = Make(Method());
  DisturbedArm arm(0.5, Vector6::Zero());
  ExecutedChunk chunk = arm.Execute(0.5 * Vector6::Unit(0), Vector6::Zero());
  without.Observe(chunk);
  for (ExecutedStep& step : chunk.steps) {
    step.base_command = step.policy_command;
    step.policy_command *= 2;  // what an adapter made of it
  }
  with.Observe(chunk);
  EXPECT_EQ(with.correction(), without.correction());
}

// The displacement of the tool over `chunks` chunks, normalised.
Eigen::Vector3d Drive(ModelFollowing& following, DisturbedArm& arm, const Vector6& command,
                      int chunks) {
  Eigen::Vector3d moved = Eigen::Vector3d::Zero();
  for (int i = 0; i < chunks; ++i) {
    const ExecutedChunk chunk = arm.Execute(command, -following.correction());
    following.Observe(chunk);
    moved += (chunk.final_state.tool.p_base_tool - chunk.steps[0].before.tool.p_base_tool) / 0.05;
  }
  return moved;
}

const Vector6 kCommand = (Vector6() << 0.2, -0.1, 0.05, 0.02, 0, -0.04).finished();
const Vector6 kDisturbance = (Vector6() << 0, 0.05, -0.3, 0.03, -0.02, 0).finished();

TEST(ModelFollowing, StandsStillWhereTheArmIsNominal) {
  ModelFollowing following = Make(Method());
  DisturbedArm arm(1, Vector6::Zero());
  for (const double scale : {1.0, -0.5, 3.0, 0.0}) Drive(following, arm, scale * kCommand, 5);
  EXPECT_LT(following.correction().cwiseAbs().maxCoeff(), 1e-6);
}

TEST(ModelFollowing, LeavesTheStatedPartOfASteadyDisturbance) {
  for (const double memory : {10.0, 20.0, 50.0}) {
    ModelFollowing following = Make(Method({"following_memory=" + std::to_string(memory)}));
    DisturbedArm arm(1, kDisturbance);
    Drive(following, arm, kCommand, 80);
    const double left = 1 / (1 + 0.3 * kSteadyGain * memory);
    EXPECT_NEAR(kDisturbance[2] + following.correction()[2], left * kDisturbance[2], 5e-3);
    EXPECT_NEAR(arm.last_motion()[2], kSteadyGain * (kCommand[2] + left * kDisturbance[2]), 2e-3);
  }
}

TEST(ModelFollowing, AWeakArmComesFartherWithIt) {
  ModelFollowing following = Make(Method()), none = Make(Method({"following_limit=0"}));
  DisturbedArm followed(0.5, Vector6::Zero()), left_alone(0.5, Vector6::Zero());
  const double with = Drive(following, followed, kCommand, 40)[0];
  const double without = Drive(none, left_alone, kCommand, 40)[0];
  EXPECT_NEAR(without, 0.5 * kSteadyGain * 0.2 * 200, 0.2);
  EXPECT_GT(with, 1.4 * without);
  EXPECT_LT(with, 2.0 * without) << "never beyond the nominal arm";
}

TEST(ModelFollowing, LostMotionThatComesBackLeavesNothing) {
  ModelFollowing following = Make(Method({"following_memory=1e6"}));
  DisturbedArm arm(1, Vector6::Zero());
  ExecutedChunk sagged = arm.Execute(kCommand, Vector6::Zero());
  ExecutedChunk back = arm.Execute(kCommand, Vector6::Zero());
  for (RobotState* state : {&sagged.final_state, &back.steps[0].before})
    state->tool.p_base_tool.z() -= 0.01;
  following.Observe(sagged);
  EXPECT_NEAR(following.correction()[2], 0.3 * 0.01 / 0.05, 1e-6);
  following.Observe(back);
  EXPECT_NEAR(following.correction()[2], 0, 1e-6);
}

TEST(ModelFollowing, FollowsInThePlaneOrInSpace) {
  for (const bool in_plane : {true, false}) {
    ModelFollowing following =
        Make(Method({in_plane ? "following_axes=horizontal" : "following_axes=translation"}));
    DisturbedArm arm(1, kDisturbance);
    Drive(following, arm, kCommand, 40);
    EXPECT_LT(following.correction()[1], -0.005);
    if (in_plane) {
      EXPECT_EQ(following.correction()[2], 0);
    } else {
      EXPECT_GT(following.correction()[2], 0.1);
    }
  }
}

TEST(ModelFollowing, AShortfallBelowTheThresholdCorrectsNothing) {
  ModelFollowing all = Make(Method()), some = Make(Method({"following_threshold=0.2"}));
  DisturbedArm arm(1, 0.25 * kDisturbance);
  bool below = false, above = false;
  for (int i = 0; i < 20; ++i) {
    const ExecutedChunk chunk = arm.Execute(kCommand, Vector6::Zero());
    all.Observe(chunk);
    some.Observe(chunk);
    const double size = all.correction().norm() / 0.3;
    below = below || size < 0.2;
    above = above || size > 0.3;
    const double share = size < 0.2 ? 0 : 1 - 0.04 / (size * size);
    EXPECT_LT((some.correction() - share * all.correction()).norm(), 1e-12);
  }
  EXPECT_TRUE(below && above);
}

TEST(ModelFollowing, KeepsItsBoundAndLeavesRotationsAlone) {
  ModelFollowing following = Make(Method({"following_limit=0.1"}));
  DisturbedArm arm(1, kDisturbance);
  Drive(following, arm, kCommand, 40);
  EXPECT_EQ(following.correction()[2], 0.1);
  EXPECT_EQ(following.correction().tail<3>(), Eigen::Vector3d::Zero());
}

TEST(ModelFollowing, MaskedStepsForgetAndAddNothing) {
  ModelFollowing following = Make(Method());
  DisturbedArm arm(1, kDisturbance);
  Drive(following, arm, kCommand, 4);
  const double before = following.correction()[2];
  ExecutedChunk chunk = arm.Execute(kCommand, Vector6::Zero());
  chunk.masked.assign(5, true);
  following.Observe(chunk);
  EXPECT_NEAR(following.correction()[2], std::pow(0.95, 5) * before, 1e-12);
}

TEST(ModelFollowing, AnEpisodeBeginsBehindNothing) {
  ModelFollowing following = Make(Method());
  DisturbedArm arm(1, kDisturbance);
  Drive(following, arm, kCommand, 4);
  EXPECT_GT(following.State().norm(), 0);
  following.StartEpisode();
  EXPECT_EQ(following.State().norm(), 0);
}

TEST(ModelFollowing, GoesOnFromItsStateBitForBit) {
  ModelFollowing straight = Make(Method()), kept = Make(Method());
  DisturbedArm arm(0.8, kDisturbance);
  Drive(straight, arm, kCommand, 7);
  kept.SetState(straight.State());
  const ExecutedChunk chunk = arm.Execute(kCommand, -straight.correction());
  straight.Observe(chunk);
  kept.Observe(chunk);
  EXPECT_EQ(kept.State(), straight.State());
}

TEST(ModelFollowing, WhatIsLostOnAnAxisThatDoesNotFollowOpensNoThreshold) {
  ModelFollowing in_space = Make(Method({"following_threshold=0.2", "following_axes=translation"}));
  ModelFollowing in_plane = Make(Method({"following_threshold=0.2", "following_axes=horizontal"}));
  // Behind by 0.1 along x and by 1 along z: |e| is 1.005 in space, 0.1 in the plane.
  Eigen::VectorXd state = Eigen::VectorXd::Zero(ModelFollowing::kStateSize);
  state[0] = 0.1;
  state[2] = 1;
  in_space.SetState(state);
  in_plane.SetState(state);
  EXPECT_NEAR(in_space.correction()[0], 0.3 * 0.1 * (1 - 0.04 / 1.01), 1e-12);
  EXPECT_EQ(in_plane.correction(), Vector6::Zero());
}

TEST(CommandCorrection, IsTheSumOfWhatTheMethodHasAndRefusesTheStateOfAnother) {
  const MethodOptions both = Method({"integral_rate=0.1"}), none = *MakeMethod("base");
  CommandCorrection correction(both, ResidualOptionsOf(both), {});
  CommandCorrection nothing(none, ResidualOptionsOf(none), {});
  IntegralAction integral(*both.Find<IntegralOptions>(), ResidualOptionsOf(both), {});
  ModelFollowing following = Make(both);
  DisturbedArm arm(1, kDisturbance);
  for (int i = 0; i < 4; ++i) {
    const ExecutedChunk chunk = arm.Execute(kCommand, -correction.Value());
    correction.Observe(chunk);
    nothing.Observe(chunk);
    integral.Observe(chunk);
    following.Observe(chunk);
  }
  EXPECT_EQ(correction.Value(), Vector6(following.correction() + integral.correction()));
  EXPECT_GT(correction.Value().norm(), 0);
  EXPECT_EQ(nothing.Value().size(), 0);
  EXPECT_FALSE(nothing.set_state(correction.state()));
  EXPECT_FALSE(correction.set_state(nothing.state()));
  EXPECT_TRUE(correction.set_state(correction.state()));
}

TEST(CommandCorrection, DirectTakesTheMeanOfTheStepsThatCount) {
  const MethodOptions direct = *MakeMethod("direct");
  CommandCorrection correction(direct, ResidualOptionsOf(direct), {});
  DisturbedArm arm(0.8, kDisturbance);
  ExecutedChunk chunk = arm.Execute(kCommand, Vector6::Zero());
  chunk.masked = {true, false, true, false, true};
  correction.Observe(chunk);
  const Eigen::MatrixXd eta = ChunkResidual(chunk, ResidualOptionsOf(direct));
  EXPECT_LT((correction.Value() + (eta.row(1) + eta.row(3)).transpose() / 2).norm(), 1e-12);
  EXPECT_GT(correction.Value().norm(), 0.1);
}

}  // namespace
}  // namespace robostress
