#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "adapter/integral_action.h"
#include "adapter/model_following.h"
#include "server/sessions/session.h"
#include "tests/server/sessions/drive.h"

// What a session adds to commands without changing its policy.

namespace robostress {
namespace {

TEST(Session, GainScalesCommandsButNotTheGripper) {
  Rig rig;
  Client base(rig.Open(Spec("base"))), gain(rig.Open(Spec("gain", {"gain=1.5"})));
  base.StartEpisode(0, 0);
  gain.StartEpisode(0, 0);
  const PredictedChunk a = base.Predict(), b = gain.Predict();
  EXPECT_EQ(b.policy_actions, a.actions);
  EXPECT_EQ(b.actions.leftCols(6), Eigen::MatrixXf(1.5f * a.actions.leftCols(6)));
  EXPECT_EQ(b.actions.col(6), a.actions.col(6));
}

TEST(Session, DirectSubtractsThePreviousChunksMeanResidualAndForgetsItBetweenEpisodes) {
  Rig rig;
  Client client(rig.Open(Spec("direct")), /*gain=*/0.5);
  client.StartEpisode(0, 0);
  const PredictedChunk first = client.RunChunk(/*steps=*/4);
  EXPECT_EQ(first.actions, first.policy_actions);
  // eta = 0.5 a - a over the four executed steps.
  const Eigen::RowVectorXf mean = -0.5f * first.policy_actions.topRows(4).colwise().mean();
  const PredictedChunk second = client.RunChunk();
  for (int i = 0; i < 10; ++i) {
    EXPECT_LT((second.actions.row(i) - (second.policy_actions.row(i) - mean)).head(6).norm(),
              1e-5f);
    EXPECT_EQ(second.actions(i, 6), second.policy_actions(i, 6));
  }
  client.StartEpisode(0, 1);
  const PredictedChunk fresh = client.Predict();
  EXPECT_EQ(fresh.actions, fresh.policy_actions);
}

TEST(Session, DirectMeasuresAgainstThePolicysCommandNotTheCorrectedOne) {
  Rig rig;
  Client client(rig.Open(Spec("direct")), /*gain=*/0.5);
  client.StartEpisode(0, 0);
  client.RunChunk();
  const PredictedChunk second = client.RunChunk();
  // The arm did half of what was sent; the residual is against what the policy wanted.
  const Eigen::RowVectorXf eta =
      (0.5f * second.actions - second.policy_actions).topRows(5).colwise().mean();
  const PredictedChunk third = client.Predict();
  EXPECT_LT(((third.policy_actions - third.actions).row(0) - eta).head(6).norm(), 1e-5f);
}

TEST(Session, IntegralActionSubtractsWhatTheArmDidBeyondANominalOneAndKeepsItBetweenEpisodes) {
  Rig rig;
  const SessionSpec spec = Spec("ours_integral", {"integral_rate=0.1"});
  Client client(rig.Open(spec), /*gain=*/0.5);
  IntegralAction expected(*spec.method->Find<IntegralOptions>(), ResidualOptionsOf(*spec.method),
                          {});
  for (int episode = 0; episode < 2; ++episode) {
    client.StartEpisode(0, episode);
    expected.StartEpisode();
    for (int chunk = 0; chunk < 4; ++chunk) {
      const PredictedChunk prediction = client.Predict();
      const Eigen::RowVectorXf d = expected.estimate().cast<float>().transpose();
      EXPECT_EQ(d.norm() > 0, episode + chunk > 0);
      EXPECT_EQ(prediction.actions.leftCols(6),
                Eigen::MatrixXf(prediction.policy_actions.leftCols(6).rowwise() - d));
      EXPECT_EQ(prediction.actions.col(6), prediction.policy_actions.col(6));
      const ExecutedChunk executed = client.Execute(prediction);
      client.Send(executed);
      expected.Observe(executed);
    }
  }
}

TEST(Session, ModelFollowingAddsWhatTheArmIsBehindAndForgetsItBetweenEpisodes) {
  Rig rig;
  const SessionSpec spec = Spec("ours_following", {"integral_rate=0", "following_threshold=0"});
  Client client(rig.Open(spec), /*gain=*/0.5);
  ModelFollowing expected(*spec.method->Find<FollowingOptions>(), ResidualOptionsOf(*spec.method),
                          {});
  for (int episode = 0; episode < 2; ++episode) {
    client.StartEpisode(0, episode);
    expected.StartEpisode();
    for (int chunk = 0; chunk < 4; ++chunk) {
      const PredictedChunk prediction = client.Predict();
      const Eigen::RowVectorXf added = expected.correction().cast<float>().transpose();
      EXPECT_EQ(added.norm() > 0, chunk > 0);
      EXPECT_EQ(prediction.actions.leftCols(6),
                Eigen::MatrixXf(prediction.policy_actions.leftCols(6).rowwise() + added));
      const ExecutedChunk executed = client.Execute(prediction);
      client.Send(executed);
      expected.Observe(executed);
    }
  }
}

TEST(Session, DirectAveragesOverUnmaskedStepsAndKeepsItsCorrectionWithoutAny) {
  Rig rig;
  Client client(rig.Open(Spec("direct"))), reference(rig.Open(Spec("direct")));
  client.StartEpisode(0, 0);
  reference.StartEpisode(0, 0);
  ExecutedChunk masked = client.Execute(client.Predict(), 5);
  masked.masked = {false, false, true, true, true};
  masked.final_state.tool.p_base_tool.array() += 1.0;
  client.Send(masked);
  reference.Send(reference.Execute(reference.Predict(), 2));
  const PredictedChunk next = client.Predict();
  const Eigen::MatrixXf correction = next.policy_actions - next.actions;
  const PredictedChunk twin = reference.Predict();
  EXPECT_LT((correction - (twin.policy_actions - twin.actions)).cwiseAbs().maxCoeff(), 1e-6f);
  EXPECT_GT(correction.cwiseAbs().maxCoeff(), 1e-3f);
  ExecutedChunk none = client.Execute(next, 5);
  none.masked.assign(5, true);
  client.Send(none);
  const PredictedChunk last = client.Predict();
  EXPECT_LT((last.policy_actions - last.actions - correction).cwiseAbs().maxCoeff(), 1e-6f);
}

}  // namespace
}  // namespace robostress
