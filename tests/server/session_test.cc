#include "server/session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "absl/synchronization/notification.h"
#include "adapter/adaptation_state.h"
#include "tests/server/drive.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

constexpr char kRate[] = "learning_rate=0.01";  // large enough to show in float32 after one step

AdaptationState StateOf(Rig& rig, Session& session) {
  auto state = ParseAdaptationState("export", ExportOf(session), *rig.policy, "fake-hash");
  EXPECT_TRUE(state.ok()) << state.status();
  return *state;
}

// ------------------------------------------------------------------------------ joint space

TEST(Session, ARobotOfJointTargetsIsCorrectedInJointSpace) {
  Rig rig;
  SessionSpec spec = Spec("ours", {kRate});
  spec.robot = "piper_new";
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

TEST(Session, RefusesInJointSpaceWhatOnlyEndEffectorCommandsCanMean) {
  Rig rig;
  for (const auto& [method, word] :
       {std::pair{"ours_nominal", "end-effector"}, std::pair{"gain", "absolute joint targets"},
        std::pair{"ours_integral", "disturbance observer"},
        std::pair{"ours_following", "model following"}}) {
    SessionSpec spec = Spec(method, {});
    spec.robot = "piper_new";
    const auto session = Session::Create(spec, {rig.policy, &rig.adaptation, &rig.inference}, 1);
    EXPECT_EQ(session.status().code(), absl::StatusCode::kInvalidArgument) << method;
    EXPECT_THAT(std::string(session.status().message()), HasSubstr(word));
  }
}

// ------------------------------------------------------------------------------ when updates
// happen

TEST(Session, UpdatesAtChunk32And40And48) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  const std::vector<std::pair<int, uint64_t>> expected{{31, 0}, {1, 1}, {7, 1},
                                                       {1, 2},  {8, 3}, {8, 4}};
  for (const auto& [chunks, updates] : expected) {
    client.RunChunks(chunks);
    EXPECT_EQ(client.updates(), updates) << "after " << client.sequence() << " chunks";
  }
}

TEST(Session, CountsAChunkThatTheEndOfTheEpisodeCutShort) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  for (int episode = 0; episode < 16; ++episode) {
    client.StartEpisode(0, episode);
    client.RunChunk(5);
    client.RunChunk(1 + episode % 4);
  }
  EXPECT_EQ(client.updates(), 1u);
}

TEST(Session, KeepsTheBufferAcrossEpisodesAndClearsItAtATaskBoundary) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunks(20);
  client.StartEpisode(0, 1);
  client.RunChunks(15);
  EXPECT_EQ(client.updates(), 1u);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 32);
  client.StartEpisode(1, 0);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 0);
  client.RunChunks(31);
  EXPECT_EQ(client.updates(), 1u);
  client.RunChunk();
  EXPECT_EQ(client.updates(), 2u);
}

TEST(Session, CarriesLoraAndAdamAcrossTasks) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunks(40);
  const AdaptationState before = StateOf(rig, client.session());
  client.StartEpisode(1, 0);
  const AdaptationState after = StateOf(rig, client.session());
  EXPECT_TRUE(BitEqual(before.lora.phi, after.lora.phi));
  EXPECT_EQ(after.lora.adam.steps, 2);
  EXPECT_TRUE(BitEqual(before.lora.adam.v[1], after.lora.adam.v[1]));
  EXPECT_TRUE(after.buffer.empty());
  EXPECT_EQ(client.RunChunk().adapter_version, 2u);
}

TEST(Session, ClearsBetweenTheLastFeedbackOfATaskAndTheFirstOfTheNextEvenIfTheLastIsLate) {
  // Async: the boundary is announced while feedback of the old task is still under way.
  Rig rig;
  SessionSpec spec = Spec("ours", {kRate});
  spec.mode = ExecutionMode::kAsync;
  Client client(rig.Open(spec));
  client.StartEpisode(0, 0);
  client.RunChunks(10);
  const ExecutedChunk late = client.Execute(client.Predict());
  client.StartEpisode(1, 0);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 10);
  client.Send(late);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 0);
  client.RunChunks(3);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 3);
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

TEST(Session, NoResidualTrainsOnTheRawPredictionItself) {
  Rig rig;
  Client client(rig.Open(Spec("no_residual", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunk();
  const torch::Tensor noise = [&] {
    torch::Tensor n = torch::empty({1, 10, 8});
    RandomStream stream(NoiseKey(Spec("no_residual"), 0, 0, 0));
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
  Rig rig;
  Client client(rig.Open(Spec("ours_nominal", {kRate})), /*gain=*/0.0);
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
        EXPECT_NEAR(state.buffer.back()->target[i][1].item<float>(), expected, 1e-5);
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

// ------------------------------------------------------------------------------------------ guard

std::shared_ptr<Session> Guarded(Rig& rig, const GuardOptions& guard) {
  auto session =
      Session::Create(Spec("ours", {kRate}), {rig.policy, &rig.adaptation, &rig.inference},
                      ++rig.last_owner, guard);
  EXPECT_TRUE(session.ok()) << session.status();
  return *session;
}

TEST(Session, AGuardThatAcceptsEverythingChangesNoBit) {
  Rig rig;
  GuardOptions lenient;
  lenient.enabled = true;
  lenient.max_loss_ratio = 1e6;
  Client guarded(Guarded(rig, lenient)), plain(rig.Open(Spec("ours", {kRate})));
  for (Client* client : {&guarded, &plain}) {
    client->StartEpisode(0, 0);
    client->RunChunks(60);
  }
  EXPECT_EQ(ExportOf(guarded.session()), ExportOf(plain.session()));
  EXPECT_EQ(guarded.updates(), 4u);
}

TEST(Session, ARefusedUpdateIsCountedAndLeavesLoraAndAdamAlone) {
  Rig rig;
  GuardOptions near, strict;
  near.enabled = strict.enabled = true;
  near.max_distance = 1e-9;
  strict.max_loss_ratio = 1e-6;
  for (const GuardOptions& guard : {near, strict}) {
    Client client(Guarded(rig, guard));
    client.StartEpisode(0, 0);
    client.RunChunks(48);
    EXPECT_EQ(client.updates(), 0u);
    EXPECT_EQ(client.session().Counters()->updates_guarded, 3u);
    EXPECT_EQ(client.session().Counters()->updates_refused, 0u);
    const AdaptationState state = StateOf(rig, client.session());
    EXPECT_EQ(state.lora.adam.steps, 0);
    EXPECT_EQ(state.lora.adam.m[0].abs().max().item<float>(), 0);
    EXPECT_EQ(client.Predict().adapter_version, 0u);
  }
}

TEST(Session, KeepsSixteenVersionsAndEveryPinnedOne) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunks(48);
  ASSERT_TRUE(client.session().Pin(2, true).ok());
  client.RunChunks(8 * 20);
  EXPECT_EQ(client.updates(), 23u);
  std::vector<uint64_t> held;
  const std::vector<PublishedVersion> versions = client.session().Versions().value();
  for (const PublishedVersion& version : versions) held.push_back(version.weights->version);
  EXPECT_EQ(held.size(), 18u);
  EXPECT_EQ(held[0], 0u);
  EXPECT_EQ(held[1], 2u);
  EXPECT_EQ(held[2], 8u);
  EXPECT_EQ(held.back(), 23u);
  EXPECT_EQ(client.session().Pin(3, true).code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(client.session().Rollback(2).ok());
  EXPECT_EQ(client.updates(), 2u);
}

// ------------------------------------------------------------------------------------- invariants

// Every action of a run of `chunks` chunks over two tasks.
Eigen::MatrixXf ActionsOf(std::shared_ptr<Session> session, int chunks) {
  Client client(std::move(session));
  Eigen::MatrixXf actions(chunks * 10, 7);
  for (int i = 0; i < chunks; ++i) {
    if (i % 25 == 0) client.StartEpisode(i / 50, i / 25);
    actions.middleRows(10 * i, 10) = client.RunChunk().actions;
  }
  return actions;
}

TEST(Session, OursEqualsBaseBitForBitUntilTheFirstUpdateAndNotAfterIt) {
  Rig rig;
  const Eigen::MatrixXf ours = ActionsOf(rig.Open(Spec("ours", {kRate})), 36);
  const Eigen::MatrixXf base = ActionsOf(rig.Open(Spec("base")), 36);
  EXPECT_EQ(ours.topRows(320), base.topRows(320));
  EXPECT_NE(ours.bottomRows(40), base.bottomRows(40));
}

TEST(Session, OursAtLearningRateZeroEqualsBaseBitForBit) {
  Rig rig;
  const auto session = rig.Open(Spec("ours", {"learning_rate=0"}));
  const Eigen::MatrixXf ours = ActionsOf(session, 100);
  EXPECT_GT(session->Counters()->stats.updates_applied, 3u);
  EXPECT_EQ(ours, ActionsOf(rig.Open(Spec("base")), 100));
}

TEST(Session, AloneOrBesideOthersComputesTheSameBits) {
  Rig quiet(1), busy(3);
  const Eigen::MatrixXf alone = ActionsOf(quiet.Open(Spec("ours", {kRate})), 60);
  SessionSpec neighbour = Spec("ours", {kRate});
  neighbour.scenario = "aged_uniform";
  Eigen::MatrixXf together, other1, other2;
  std::thread a([&] { together = ActionsOf(busy.Open(Spec("ours", {kRate})), 60); });
  a.join();
  EXPECT_EQ(alone, together);
  auto s0 = busy.Open(Spec("ours", {kRate})), s1 = busy.Open(neighbour), s2 = busy.Open(neighbour);
  std::thread b([&] { together = ActionsOf(s0, 60); });
  std::thread c([&] { other1 = ActionsOf(s1, 60); });
  std::thread d([&] { other2 = ActionsOf(s2, 60); });
  b.join();
  c.join();
  d.join();
  EXPECT_EQ(alone, together);
  EXPECT_EQ(other1, other2);
  EXPECT_NE(alone, other1);  // other draws, since the session's identity differs
}

TEST(Session, TheSameFeedbackGivesTheSameAdapterInLockstepAndAsync) {
  // All predictions are made at version 0 in both, so that feedback is the same; then it streams
  // in.
  std::vector<std::string> exports;
  for (const ExecutionMode mode : {ExecutionMode::kLockstep, ExecutionMode::kAsync}) {
    Rig rig;
    SessionSpec spec = Spec("ours", {kRate, "buffer_chunks=8", "update_interval=2"});
    spec.mode = mode;
    Client client(rig.Open(spec));
    client.StartEpisode(0, 0);
    std::vector<PredictedChunk> predictions;
    Observation observation = FakePolicy::MakeObservation(0);
    for (int i = 0; i < 40; ++i) {
      observation = FakePolicy::MakeObservation(i);
      predictions.push_back(*client.session().Predict(observation, 0, 0, i, 0));
    }
    for (int i = 0; i < 40; ++i) {
      ExecutedChunk executed = client.Execute(predictions[i]);
      executed.chunk = i;
      client.Send(executed);
    }
    exports.push_back(ExportOf(client.session()));
  }
  EXPECT_EQ(exports[0], exports[1]);
}

TEST(Session, NoiseDependsOnSeedSuiteTaskEpisodeAndChunkOnly) {
  const auto draw = [](const SessionSpec& spec, int task, int episode, int chunk) {
    return RandomStream(NoiseKey(spec, task, episode, chunk)).Normal();
  };
  const SessionSpec reference = Spec("base");
  SessionSpec other = Spec("ours");
  other.scenario = "clean";
  other.severity = 1;
  other.robot = "another";
  other.policy = "another";
  EXPECT_EQ(draw(reference, 1, 2, 3), draw(other, 1, 2, 3));
  EXPECT_NE(draw(reference, 1, 2, 3), draw(reference, 0, 2, 3));
  EXPECT_NE(draw(reference, 1, 2, 3), draw(reference, 1, 3, 2));
  SessionSpec seed = reference, suite = reference;
  seed.seed = 4;
  suite.suite = "tabletop_long";
  EXPECT_NE(draw(reference, 1, 2, 3), draw(seed, 1, 2, 3));
  EXPECT_NE(draw(reference, 1, 2, 3), draw(suite, 1, 2, 3));
  EXPECT_NE(draw(reference, 1, 2, 3), draw(Spec("null"), 1, 2, 3));
}

TEST(Session, BaseActionsAreTheUnadaptedPolicys) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  const PredictedChunk before = client.RunChunk();
  EXPECT_EQ(before.base_actions, before.policy_actions);
  client.RunChunks(31);
  const PredictedChunk after = client.Predict();
  EXPECT_EQ(after.adapter_version, 1u);
  EXPECT_NE(after.base_actions, after.policy_actions);

  Client silent(rig.Open(Spec("ours", {kRate, "track_intent=false"})));
  silent.StartEpisode(0, 0);
  EXPECT_EQ(silent.Predict().base_actions.size(), 0);
}

// ------------------------------------------------------------------------------ order of messages

TEST(Session, IgnoresADuplicateAndRefusesAGap) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  const ExecutedChunk first = client.Execute(client.Predict());
  client.Send(first);
  const auto again = client.session().Feedback(first);
  ASSERT_TRUE(again.ok());
  EXPECT_EQ(again->sequence, 1u);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 1);

  ExecutedChunk gap = client.Execute(client.Predict());
  gap.sequence = 5;
  const auto refused = client.session().Feedback(gap);
  EXPECT_EQ(refused.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(refused.status().message()),
              HasSubstr("feedback 5 after 1; send 2 first"));
}

TEST(Session, RefusesFeedbackAboutAPredictionItDoesNotHold) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  const PredictedChunk old = client.Predict();
  client.RunChunk();
  ExecutedChunk stale = client.Execute(old);  // older than one that was already reported
  EXPECT_EQ(client.session().Feedback(stale).status().code(),
            absl::StatusCode::kFailedPrecondition);
  stale.prediction_id = 99;
  EXPECT_THAT(std::string(client.session().Feedback(stale).status().message()),
              HasSubstr("prediction 99"));
}

TEST(Session, RefusesFeedbackThatNamesAnotherEpisodeThanItsPrediction) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  ExecutedChunk executed = client.Execute(client.Predict());
  executed.episode = 7;
  EXPECT_THAT(std::string(client.session().Feedback(executed).status().message()),
              HasSubstr("episode 7"));
}

TEST(Session, LockstepPredictionWaitsForTheFeedbackItAnnounces) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate, "buffer_chunks=1", "update_interval=1", "batch=1"})));
  client.StartEpisode(0, 0);
  const ExecutedChunk executed = client.Execute(client.Predict());  // sequence 1, not sent yet
  absl::Notification answered;
  PredictedChunk prediction;
  std::thread waiting([&] {
    prediction =
        *client.session().Predict(FakePolicy::MakeObservation(1), 0, 0, 1, /*last_sequence=*/1);
    answered.Notify();
  });
  EXPECT_FALSE(answered.WaitForNotificationWithTimeout(absl::Milliseconds(50)));
  EXPECT_TRUE(client.session().Feedback(executed).ok());
  waiting.join();
  EXPECT_EQ(prediction.adapter_version, 1u) << "the update that the feedback triggered must be in";
}

TEST(Session, LockstepSaysWhichFeedbackIsMissing) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate}), absl::Milliseconds(20)));
  client.StartEpisode(0, 0);
  const auto prediction = client.session().Predict(FakePolicy::MakeObservation(0), 0, 0, 0, 4);
  EXPECT_EQ(prediction.status().code(), absl::StatusCode::kDeadlineExceeded);
  EXPECT_THAT(std::string(prediction.status().message()), HasSubstr("feedback 4"));
}

TEST(Session, AsyncPredictionNeverWaitsForFeedbackOrLearning) {
  Rig rig(1);
  absl::Notification release;
  rig.adaptation.Post(
      0, [&release] { release.WaitForNotification(); });  // the only learning thread is busy
  SessionSpec spec = Spec("ours", {kRate, "buffer_chunks=1", "update_interval=1", "batch=1"});
  spec.mode = ExecutionMode::kAsync;
  Client client(rig.Open(spec));
  client.StartEpisode(0, 0);
  client.RunChunk();
  EXPECT_EQ(client.Predict().adapter_version, 0u);  // due, not published, not waited for
  ASSERT_TRUE(client.session().Predict(FakePolicy::MakeObservation(0), 0, 0, 9, 1000).ok());
  release.Notify();
  EXPECT_EQ(StateOf(rig, client.session()).lora.phi.version, 1u);
}

TEST(Session, CancelEndsAWait) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  std::thread waiting([&] {
    EXPECT_EQ(client.session().Predict(FakePolicy::MakeObservation(0), 0, 0, 0, 9).status().code(),
              absl::StatusCode::kCancelled);
  });
  client.session().Cancel();
  waiting.join();
}

TEST(Session, PredictionNeedsTheEpisodeThatIsOpen) {
  Rig rig;
  const auto session = rig.Open(Spec("base"));
  EXPECT_THAT(
      std::string(session->Predict(FakePolicy::MakeObservation(0), 0, 0, 0, 0).status().message()),
      HasSubstr("no episode is open"));
  ASSERT_TRUE(session->StartEpisode(0, 0, 0).ok());
  EXPECT_THAT(
      std::string(session->Predict(FakePolicy::MakeObservation(0), 0, 1, 0, 0).status().message()),
      HasSubstr("task 0 episode 0 is open"));
}

// ------------------------------------------------------------------------------- export and import

TEST(Session, ContinuesBitForBitFromAnExport) {
  Rig rig;
  for (const char* method : {"ours", "ours_intent", "ours_nominal"}) {
    const SessionSpec spec = Spec(method, {kRate});
    Client client(rig.Open(spec));
    client.StartEpisode(0, 0);
    client.RunChunks(43);
    const std::string saved = ExportOf(client.session());

    // The copy takes over in the middle of the buffer's cycle, at an episode boundary.
    Client copy = client;
    copy.set_session(rig.Open(spec));
    const auto imported = copy.session().Import(saved);
    ASSERT_TRUE(imported.ok()) << imported.status();
    EXPECT_EQ(imported->sequence, 43u);
    EXPECT_EQ(imported->updates_applied, 2u);
    EXPECT_EQ(ExportOf(copy.session()), saved);
    for (Client* c : {&client, &copy}) {
      c->StartEpisode(0, 1);
      c->RunChunks(20);
    }
    EXPECT_EQ(ExportOf(copy.session()), ExportOf(client.session())) << method;
    EXPECT_EQ(copy.Predict().actions, client.Predict().actions);
  }
}

TEST(Session, ImportRefusesAnotherMethodsAdapterAndRubbish) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  const std::string saved = ExportOf(client.session());
  const auto other = rig.Open(Spec("no_anchor", {kRate}));
  EXPECT_THAT(std::string(other->Import(saved).status().message()),
              HasSubstr("learned by method ours"));
  EXPECT_EQ(client.session().Import("rubbish").status().code(), absl::StatusCode::kInvalidArgument);
  const auto rank = rig.Open(Spec("ours", {kRate, "rank=2"}));
  EXPECT_EQ(rank->Import(saved).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(rig.Open(Spec("base"))->Export().status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST(Session, RollsBackWithANewBuffer) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunks(48);
  EXPECT_EQ(client.updates(), 3u);
  ASSERT_TRUE(client.session().Rollback(1).ok());
  EXPECT_EQ(client.updates(), 1u);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 0);
  EXPECT_EQ(client.session().Rollback(3).code(), absl::StatusCode::kNotFound);
}

// --------------------------------------------------------------------------------------- bad input

TEST(Session, RefusesMethodOptionsThatMakeNoSense) {
  Rig rig;
  const auto refusal = [&rig](const SessionSpec& spec) {
    return std::string(
        Session::Create(spec, {rig.policy, &rig.adaptation, &rig.inference}, 1).status().message());
  };
  EXPECT_THAT(refusal(Spec("ours", {"batch=40"})), HasSubstr("batch is 40, must be 1..32"));
  EXPECT_THAT(refusal(Spec("ours", {"learning_rate=-1"})), HasSubstr("learning_rate is -1"));
  EXPECT_THAT(refusal(Spec("ours", {"rank=0"})), HasSubstr("rank is 0"));
  EXPECT_THAT(refusal(Spec("ours", {"direct=true"})), HasSubstr("exclude each other"));
  EXPECT_THAT(refusal(Spec("ours_integral", {"direct=true"})), HasSubstr("exclude each other"));
  EXPECT_THAT(refusal(Spec("ours_integral", {"integral_rate=1.5"})),
              HasSubstr("integral_rate is 1.5, must be 0..1"));
  EXPECT_THAT(refusal(Spec("ours_following", {"direct=true"})), HasSubstr("exclude each other"));
  EXPECT_THAT(refusal(Spec("ours_following", {"following_memory=0.5"})),
              HasSubstr("following_memory is 0.5, must be 1..1e6"));
  SessionSpec unknown = Spec("base");
  unknown.method.method = "magic";
  EXPECT_THAT(refusal(unknown), HasSubstr("unknown method 'magic'; known: base, ours"));
}

TEST(Session, RefusesAnObservationOfAnotherShape) {
  Rig rig;
  const auto session = rig.Open(Spec("base"));
  ASSERT_TRUE(session->StartEpisode(0, 0, 0).ok());
  Observation observation = FakePolicy::MakeObservation(0);
  observation.proprioception.resize(5);
  EXPECT_EQ(session->Predict(observation, 0, 0, 0, 0).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace robostress
