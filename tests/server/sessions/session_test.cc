#include "server/sessions/session.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

#include "absl/synchronization/notification.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

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
      predictions.push_back(*client.session().Predict(Shared(observation), {{0, 0}, i}, 0));
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
    return RandomStream(NoiseKey(spec, {{task, episode}, chunk})).Normal();
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
    prediction = *client.session().Predict(Shared(FakePolicy::MakeObservation(1)), {{0, 0}, 1},
                                           /*last_sequence=*/1);
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
  const auto prediction =
      client.session().Predict(Shared(FakePolicy::MakeObservation(0)), {{0, 0}, 0}, 4);
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
  ASSERT_TRUE(
      client.session().Predict(Shared(FakePolicy::MakeObservation(0)), {{0, 0}, 9}, 1000).ok());
  release.Notify();
  EXPECT_EQ(StateOf(rig, client.session()).lora.phi.version, 1u);
}

TEST(Session, CancelEndsAWait) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  std::thread waiting([&] {
    EXPECT_EQ(client.session()
                  .Predict(Shared(FakePolicy::MakeObservation(0)), {{0, 0}, 0}, 9)
                  .status()
                  .code(),
              absl::StatusCode::kCancelled);
  });
  client.session().Cancel();
  waiting.join();
}

TEST(Session, PredictionNeedsTheEpisodeThatIsOpen) {
  Rig rig;
  const auto session = rig.Open(Spec("base"));
  EXPECT_THAT(std::string(session->Predict(Shared(FakePolicy::MakeObservation(0)), {{0, 0}, 0}, 0)
                              .status()
                              .message()),
              HasSubstr("no episode is open"));
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  EXPECT_THAT(std::string(session->Predict(Shared(FakePolicy::MakeObservation(0)), {{0, 1}, 0}, 0)
                              .status()
                              .message()),
              HasSubstr("task 0 episode 0 is open"));
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
  EXPECT_THAT(refusal(Spec("ours_following_step")), HasSubstr("is done beside the arm"));
  SessionSpec unknown = Spec("base");
  unknown.method.Edit().method = "magic";
  EXPECT_THAT(refusal(unknown), HasSubstr("unknown method 'magic'; known: base, ours"));
}

TEST(Session, GoesOnFromARunningChunkOnlyWhereThePolicyCan) {
  Rig rig;
  const auto session = rig.Open(Spec("base"));
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  const auto observation = Shared(FakePolicy::MakeObservation(0));
  PredictOptions options;
  options.running.emplace();
  options.running->actions = Eigen::MatrixXf::Zero(2, 7);
  const absl::Status refused = session->Predict(observation, {{0, 0}, 0}, 0, options).status();
  EXPECT_TRUE(absl::IsUnimplemented(refused)) << refused;
  EXPECT_TRUE(session->Predict(observation, {{0, 0}, 0}, 0).ok());
}

TEST(Session, RefusesAnObservationOfAnotherShape) {
  Rig rig;
  const auto session = rig.Open(Spec("base"));
  ASSERT_TRUE(session->StartEpisode({0, 0}, 0).ok());
  Observation observation = FakePolicy::MakeObservation(0);
  observation.proprioception.resize(5);
  EXPECT_EQ(session->Predict(Shared(observation), {{0, 0}, 0}, 0).status().code(),
            absl::StatusCode::kInvalidArgument);
}

}  // namespace
}  // namespace robostress
