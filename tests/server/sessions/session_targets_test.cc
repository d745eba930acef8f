#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "server/sessions/session.h"
#include "server/sessions/session_checks.h"
#include "tests/server/sessions/drive.h"

// What a session learns from: residuals, targets, masks.

namespace robostress {
namespace {

using ::testing::HasSubstr;

// ------------------------------------------------------------------------------ joint space

TEST(Session, ARobotOfJointTargetsIsCorrectedInJointSpace) {
  Rig rig;
  SessionSpec spec = Spec("ours", {kRate});
  spec.control_space = ControlSpace::kJoint;
  Client client(rig.Open(spec));
  client.StartEpisode(0, 0);
  const PredictedChunk prediction = client.Predict();
  ExecutedChunk executed = client.Execute(prediction);
  // Every joint stays 0.1 rad behind its target; the tool's motion says something else entirely.
  const Eigen::Index arm = prediction.policy_actions.cols() - 1;
  for (size_t i = 0; i < executed.steps.size(); ++i) {
    const Eigen::VectorXf target = prediction.policy_actions.row(static_cast<Eigen::Index>(i));
    RobotState& after =
        i + 1 < executed.steps.size() ? executed.steps[i + 1].before : executed.final_state;
    after.q = target.head(arm).cast<double>().array() - 0.1;
    after.dq = Eigen::VectorXd::Zero(arm);
  }
  executed.steps[0].before.q = executed.steps[0].before.dq = Eigen::VectorXd::Zero(arm);
  client.Send(executed);
  const AdaptationState state = StateOf(rig, client.session());
  ASSERT_EQ(state.buffer.size(), 1u);
  const auto rows = static_cast<Eigen::Index>(executed.steps.size());
  Eigen::MatrixXf expected = prediction.policy_actions.topRows(rows);
  expected.leftCols(arm).array() += 0.1f;  // a - eta; the gripper's own target stays
  const torch::Tensor model = rig.policy->ToModel(expected, state.buffer[0]->context.state);
  const torch::Tensor target =  // without the padding of model space
      state.buffer[0]->target.narrow(0, 0, rows).narrow(1, 0, model.size(1));
  EXPECT_LT((target - model).abs().max().item<float>(), 1e-5f);

  ExecutedChunk wrong = client.Execute(client.Predict());  // the toy arm measures no joints
  EXPECT_EQ(client.session().Feedback(wrong).status().code(), absl::StatusCode::kInvalidArgument);
}

TEST(Session, RefusesScalesByWhichNoMotionCanBeDivided) {
  Rig rig;
  for (double SessionSetting::*scale :
       {&SessionSetting::translation_scale, &SessionSetting::rotation_scale,
        &SessionSetting::control_period_s}) {
    for (const double wrong : {0.0, -0.05, 9e-7, 100.5, std::nan(""), HUGE_VAL}) {
      SessionSpec spec = Spec("ours");
      spec.*scale = wrong;
      const absl::Status status = CheckSessionSpec(spec, rig.policy->spec());
      EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument) << wrong;
      EXPECT_THAT(std::string(status.message()), HasSubstr("must be 1e-6..100")) << wrong;
    }
    for (const double right : {1e-6, 100.0}) {
      SessionSpec spec = Spec("ours");
      spec.*scale = right;
      EXPECT_TRUE(CheckSessionSpec(spec, rig.policy->spec()).ok()) << right;
    }
  }
}

TEST(Session, RefusesInJointSpaceWhatOnlyEndEffectorCommandsCanMean) {
  Rig rig;
  for (const auto& [method, word] :
       {std::pair{"ours_nominal", "end-effector"}, std::pair{"gain", "absolute joint targets"},
        std::pair{"ours_integral", "disturbance observer"},
        std::pair{"ours_following", "model following"}}) {
    SessionSpec spec = Spec(method, {});
    spec.control_space = ControlSpace::kJoint;
    const auto session = Session::Create(spec, {rig.policy, &rig.adaptation, &rig.inference}, 1);
    EXPECT_EQ(session.status().code(), absl::StatusCode::kInvalidArgument) << method;
    EXPECT_THAT(std::string(session.status().message()), HasSubstr(word));
  }
}

TEST(Session, WhatActionsAreIsSaidByThePolicyAndNeverByAName) {
  using enum ControlSpace;
  const auto space = [](ControlSpace robot, ControlSpace said, const char* method) {
    SessionSpec spec = Spec(method, {});
    spec.robot = "so101";
    spec.control_space = robot;
    PolicySpec policy;
    policy.name = "six_joints";
    policy.control_space = said;
    return ControlSpaceOf(spec, policy);
  };
  EXPECT_EQ(space(kUnspecified, kJoint, "ours").value(), kJoint);
  EXPECT_EQ(space(kUnspecified, kEndEffector, "ours").value(), kEndEffector);
  EXPECT_EQ(space(kJoint, kUnspecified, "ours").value(), kJoint);
  EXPECT_EQ(space(kJoint, kJoint, "ours").value(), kJoint);
  EXPECT_EQ(space(kUnspecified, kUnspecified, "base").value(), kEndEffector);
  for (const char* method : {"ours", "direct", "gain", "ours_integral", "ours_following"}) {
    EXPECT_THAT(std::string(space(kUnspecified, kUnspecified, method).status().message()),
                HasSubstr("'six_joints' does not say what its actions are: give control_space"));
  }
  EXPECT_THAT(std::string(space(kEndEffector, kJoint, "ours").status().message()),
              HasSubstr("'six_joints' commands joint targets, robot 'so101' takes end-effector"));
  EXPECT_THAT(std::string(space(kJoint, kEndEffector, "base").status().message()),
              HasSubstr("robot 'so101' takes joint targets"));
}

// -------------------------------------------------------------------------------- what is learned

TEST(Session, CorrectsExecutedStepsOnlyAndTakesTheTargetThroughTheTrainingTransform) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})), /*gain=*/0.6);
  client.StartEpisode(0, 0);
  const PredictedChunk prediction = client.Predict();
  client.Send(client.Execute(prediction, /*steps=*/3));
  const AdaptationState state = StateOf(rig, client.session());
  ASSERT_EQ(state.buffer.size(), 1u);
  const torch::Tensor target = state.buffer[0]->target;
  const torch::Tensor raw = rig.policy->ToModel(prediction.policy_actions, {});
  for (int64_t i = 0; i < 10; ++i) {
    for (int64_t j = 0; j < 6; ++j) {
      const double a = prediction.policy_actions(i, j);
      // Model = (environment - 0.02 j) / scale; an arm of gain 0.6 has the target (2 - 0.6) a, |a|
      // < 1.
      ASSERT_LT(std::abs(a), 1) << "the fake policy must not be clipped in this test";
      const double expected =
          i < 3 ? (1.4 * a - 0.02 * j) / FakePolicy::kScale : raw[i][j].item<float>();
      EXPECT_NEAR(target[i][j].item<float>(), expected, 1e-5) << i << ", " << j;
    }
    EXPECT_NEAR(target[i][6].item<float>(), raw[i][6].item<float>(), 1e-5);
  }
}

TEST(Session, LearnsWhatWasSentOnExecutedStepsAndTheUnadaptedPolicyElsewhere) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate, "target=sent"})));
  client.StartEpisode(0, 0);
  const PredictedChunk prediction = client.Predict();
  PredictedChunk corrected = prediction;
  corrected.actions.leftCols(6).array() += 0.05f;  // beside the arm
  client.Send(client.Execute(corrected, /*steps=*/3));
  const AdaptationState state = StateOf(rig, client.session());
  ASSERT_EQ(state.buffer.size(), 1u);
  Eigen::MatrixXf expected = prediction.base_actions;
  expected.topLeftCorner(3, 6).array() += 0.05f;
  const torch::Tensor model = rig.policy->ToModel(expected, {});
  EXPECT_LT(
      (state.buffer[0]->target.narrow(1, 0, 6) - model.narrow(1, 0, 6)).abs().max().item<float>(),
      1e-5);
}

TEST(Session, NoResidualTrainsOnTheRawPredictionItself) {
  Rig rig;
  Client client(rig.Open(Spec("no_residual", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunk();
  const torch::Tensor noise = [&] {
    torch::Tensor n = torch::empty({1, 10, 8});
    RandomStream stream(NoiseKey(Spec("no_residual"), {}));
    for (int i = 0; i < 80; ++i) n.data_ptr<float>()[i] = static_cast<float>(stream.Normal());
    return n;
  }();
  Observation observation = FakePolicy::MakeObservation(0);
  observation.proprioception.setZero();
  const torch::Tensor raw = rig.policy->Sample(*rig.policy->Encode(observation), noise, nullptr)[0];
  EXPECT_TRUE(BitEqual(StateOf(rig, client.session()).buffer[0]->target, raw));
}

TEST(Session, IntentTargetIsTakenAgainstTheUnadaptedPolicy) {
  Rig rig;
  const std::vector<std::string> overrides{kRate, "residual_scale=command", "track_intent=false"};
  Client client(rig.Open(Spec("ours_intent", overrides)), /*gain=*/0.6);
  client.StartEpisode(0, 0);
  client.RunChunks(48);
  const PredictedChunk prediction = client.Predict();
  ASSERT_EQ(prediction.base_actions.rows(), 10)
      << "the target needs it although track_intent is off";
  ASSERT_GT((prediction.base_actions - prediction.policy_actions).cwiseAbs().maxCoeff(), 1e-3f);
  client.Send(client.Execute(prediction));
  const AdaptationState state = StateOf(rig, client.session());
  const torch::Tensor target = state.buffer.back()->target;
  for (int j = 0; j < 6; ++j) {
    const double a = prediction.policy_actions(1, j), base = prediction.base_actions(1, j);
    EXPECT_NEAR(target[1][j].item<float>(), (a - (0.6 * a - base) - 0.02 * j) / FakePolicy::kScale,
                2e-5);
  }
}

TEST(Session, NominalTargetRunsItsArmAlongTheEpisode) {
  // A motionless arm: the target is a + dx_nominal, and dx_nominal of the second chunk knows the
  // first.
  for (const char* target : {"target=nominal", "target=nominal_intent"}) {
    Rig rig;
    Client client(rig.Open(Spec("ours_nominal", {kRate, target})), /*gain=*/0.0);
    NominalArm arm({});
    for (int episode = 0; episode < 2; ++episode) {
      client.StartEpisode(0, episode);
      arm.Reset();
      for (int c = 0; c < 2; ++c) {
        const PredictedChunk prediction = client.RunChunk();
        const AdaptationState state = StateOf(rig, client.session());
        for (int i = 0; i < 5; ++i) {
          const NominalArm::Vector6 nominal =
              arm.Step(prediction.actions.row(i).head<6>().transpose().cast<double>());
          const double expected =
              (prediction.policy_actions(i, 1) + nominal[1] - 0.02) / FakePolicy::kScale;
          EXPECT_NEAR(state.buffer.back()->target[i][1].item<float>(), expected, 1e-5) << target;
        }
      }
    }
  }
}

TEST(Session, MaskedStepsKeepThePredictionItselfAndTheRestOfTheChunkIsLearned) {
  for (const std::string method : {"ours", "ours_intent", "ours_nominal"}) {
    Rig rig;
    Client client(rig.Open(Spec(method, {kRate})));
    client.StartEpisode(0, 0);
    const PredictedChunk prediction = client.Predict();
    ExecutedChunk whole = client.Execute(prediction, /*steps=*/5);
    ExecutedChunk masked = whole;
    masked.masked = {false, true, true, false, false};
    masked.steps[2].before.tool.p_base_tool.array() += 1.0;  // seen by masked steps alone
    masked.steps[1].policy_command.array() += 0.1f;
    client.Send(masked);
    const torch::Tensor target = StateOf(rig, client.session()).buffer[0]->target;
    const torch::Tensor raw = rig.policy->ToModel(prediction.policy_actions, {});
    Client other(rig.Open(Spec(method, {kRate})));
    other.StartEpisode(0, 0);
    ExecutedChunk reference = whole;
    reference.prediction_id = other.Predict().prediction_id;
    other.Send(reference);
    const torch::Tensor unmasked = StateOf(rig, other.session()).buffer[0]->target;
    for (const int row : {0, 3, 4}) EXPECT_TRUE(BitEqual(target[row], unmasked[row])) << row;
    for (const int row : {1, 2}) {
      EXPECT_LT((target[row].narrow(0, 0, 7) - raw[row]).abs().max().item<float>(), 1e-5f);
      EXPECT_FALSE(BitEqual(target[row], unmasked[row])) << row;
    }
    EXPECT_EQ(client.session().Counters()->steps_masked, 2u);
  }
}

TEST(Session, AMaskOfAnotherLengthIsRefused) {
  Rig rig;
  Client client(rig.Open(Spec("ours")));
  client.StartEpisode(0, 0);
  ExecutedChunk executed = client.Execute(client.Predict(), 5);
  executed.masked = {true, false};
  EXPECT_THAT(std::string(client.session().Feedback(executed).status().message()),
              HasSubstr("2 mask values for 5 steps"));
}

}  // namespace
}  // namespace robostress
