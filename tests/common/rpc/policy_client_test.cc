#include "common/rpc/policy_client.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/common/rpc/fake_policy_server.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

PolicyClientOptions Options(const std::string& address) {
  PolicyClientOptions options;
  options.address = address;
  options.connect_timeout_s = 60;
  options.call_timeout_s = 120;
  return options;
}

RequestedSession Session(ExecutionMode mode = ExecutionMode::kLockstep) {
  RequestedSession session;
  session.suite = "tabletop_goal";
  session.scenario = "clean";
  session.policy = "fake";
  session.seed = 3;
  session.mode = mode;
  session.method_yaml = "{method: ours, learning_rate: 0.125}";
  return session;
}

Observation Observe() {
  Observation observation;
  observation.instruction = "open the drawer";
  observation.proprioception = Eigen::VectorXf::LinSpaced(2, 0.5f, -0.25f);
  return observation;
}

ExecutedChunk Execute(uint64_t sequence, const PredictedChunk& prediction, int chunk) {
  ExecutedChunk executed;
  executed.sequence = sequence;
  executed.chunk = chunk;
  executed.prediction_id = prediction.prediction_id;
  for (int i = 0; i < 2; ++i) {
    ExecutedStep& step = executed.steps.emplace_back();
    step.before.q = step.before.dq = Eigen::VectorXd::Zero(7);
    step.policy_command = prediction.policy_actions.row(i).transpose();
    step.sent_command = prediction.actions.row(i).transpose();
    step.base_command = prediction.base_actions.row(i).transpose();
  }
  executed.final_state = executed.steps[0].before;
  executed.final_state.tool.p_base_tool.x() = 0.01 * static_cast<double>(sequence);
  return executed;
}

// Predicts and executes `chunks` chunks; returns the sum of all actions.
double Drive(GrpcPolicyClient& client, int chunks, int first_chunk = 0) {
  double sum = 0;
  for (int chunk = first_chunk; chunk < first_chunk + chunks; ++chunk) {
    const absl::StatusOr<PredictedChunk> prediction = client.Predict(Observe(), chunk);
    EXPECT_TRUE(prediction.ok()) << prediction.status();
    if (!prediction.ok()) return 0;
    sum += prediction->actions.sum();
    const absl::Status sent =
        client.SendFeedback(Execute(client.last_feedback_sequence() + 1, *prediction, chunk));
    EXPECT_TRUE(sent.ok()) << sent;
  }
  return sum;
}

TEST(PolicyClientTest, PredictsSendsFeedbackAndCountsUpdates) {
  FakePolicyServer server({.spec = FakeSpec()});
  {
    auto client = GrpcPolicyClient::Connect(Options(server.address()), Session());
    ASSERT_TRUE(client.ok()) << client.status();
    EXPECT_EQ((*client)->spec().name, "fake");
    EXPECT_EQ(server.open_sessions(), 1);
    ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
    Drive(**client, 6);
    const absl::StatusOr<SessionStats> stats = (*client)->Stats();
    ASSERT_TRUE(stats.ok()) << stats.status();
    EXPECT_EQ(stats->feedback_chunks, 6u);
    EXPECT_EQ(stats->updates_applied, 2u);  // after chunks 4 and 6
    const absl::StatusOr<PredictedChunk> next = (*client)->Predict(Observe(), 6);
    ASSERT_TRUE(next.ok());
    EXPECT_EQ(next->adapter_version, 2u);
  }
  EXPECT_EQ(server.open_sessions(), 0) << "the destructor closes the session";
}

TEST(PolicyClientTest, AsyncSessionsAcknowledgeEverythingBeforeStats) {
  FakePolicyServer server({.spec = FakeSpec()});
  auto client =
      GrpcPolicyClient::Connect(Options(server.address()), Session(ExecutionMode::kAsync));
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  Drive(**client, 60);
  const absl::StatusOr<SessionStats> stats = (*client)->Stats();
  ASSERT_TRUE(stats.ok()) << stats.status();
  EXPECT_EQ(stats->feedback_chunks, 60u);
}

TEST(PolicyClientTest, FeedbackWhoseAnswerIsLostIsSentAgainAndTakenOnce) {
  FakePolicyServer server({.spec = FakeSpec(), .lose_ack_of = 3});
  PolicyClientOptions options = Options(server.address());
  options.max_unacknowledged = 0;  // an answer that is lost is missed at once
  auto client = GrpcPolicyClient::Connect(options, Session(ExecutionMode::kAsync));
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  for (int chunk = 0; chunk < 6; ++chunk) {
    const absl::StatusOr<PredictedChunk> prediction = (*client)->Predict(Observe(), chunk);
    ASSERT_TRUE(prediction.ok()) << prediction.status();
    const absl::Status sent = (*client)->SendFeedback(
        Execute((*client)->last_feedback_sequence() + 1, *prediction, chunk));
    EXPECT_EQ(sent.ok(), chunk != 2) << sent;
    if (chunk == 2) {
      EXPECT_EQ((*client)->acknowledged_feedback_sequence(), 2u);
    }
  }
  EXPECT_EQ((*client)->acknowledged_feedback_sequence(), 6u);
  EXPECT_EQ(server.feedback_chunks(), 6) << "each once";
}

TEST(PolicyClientTest, ResumesWithItsTokenAndSendsAgainWhatWasNotAcknowledged) {
  FakePolicyServer server({.spec = FakeSpec(), .lose_ack_of = 3});
  PolicyClientOptions options = Options(server.address());
  options.reconnect_timeout_s = 20;
  auto client = GrpcPolicyClient::Connect(options, Session());
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  Drive(**client, 6);  // no call fails
  EXPECT_EQ((*client)->resumes(), 1u);
  EXPECT_EQ((*client)->acknowledged_feedback_sequence(), 6u);
  EXPECT_EQ(server.feedback_chunks(), 6) << "each once";
}

TEST(PolicyClientTest, ASessionThatIsLeftIsResumedByAnotherClient) {
  FakePolicyServer server({.spec = FakeSpec()});
  SessionTicket ticket;
  {
    auto client = GrpcPolicyClient::Connect(Options(server.address()), Session());
    ASSERT_TRUE(client.ok() && (*client)->StartEpisode({0, 0}).ok());
    Drive(**client, 5);
    ticket = (*client)->Leave();
  }
  EXPECT_EQ(server.open_sessions(), 1);
  SessionTicket wrong = ticket;
  wrong.token[3] = 'f';
  EXPECT_EQ(GrpcPolicyClient::Resume(Options(server.address()), wrong, ExecutionMode::kLockstep)
                .status()
                .code(),
            absl::StatusCode::kPermissionDenied);
  auto client =
      GrpcPolicyClient::Resume(Options(server.address()), ticket, ExecutionMode::kLockstep);
  ASSERT_TRUE(client.ok()) << client.status();
  EXPECT_EQ((*client)->last_feedback_sequence(), 5u);
  ASSERT_TRUE((*client)->StartEpisode({0, 1}).ok());
  Drive(**client, 3);
  EXPECT_EQ(server.feedback_chunks(), 8);
}

TEST(PolicyClientTest, ImportedAdapterContinuesBitForBit) {
  FakePolicyServer server({.spec = FakeSpec()});
  auto straight = GrpcPolicyClient::Connect(Options(server.address()), Session());
  auto first = GrpcPolicyClient::Connect(Options(server.address()), Session());
  ASSERT_TRUE(straight.ok() && first.ok());
  ASSERT_TRUE((*straight)->StartEpisode({0, 0}).ok() && (*first)->StartEpisode({0, 0}).ok());
  Drive(**straight, 7);
  const double expected = Drive(**straight, 5, 7);
  Drive(**first, 7);
  const absl::StatusOr<AdapterState> state = (*first)->ExportAdapter();
  ASSERT_TRUE(state.ok()) << state.status();
  EXPECT_EQ(state->feedback_sequence, 7u);
  auto second = GrpcPolicyClient::Connect(Options(server.address()), Session());
  ASSERT_TRUE(second.ok());
  const absl::StatusOr<uint64_t> sequence = (*second)->ImportAdapter(state->safetensors);
  ASSERT_TRUE(sequence.ok()) << sequence.status();
  EXPECT_EQ(*sequence, 7u);
  EXPECT_FALSE((*second)->Predict(Observe(), 7).ok()) << "an import stands between episodes";
  ASSERT_TRUE((*second)->StartEpisode({0, 0}).ok());
  EXPECT_EQ(Drive(**second, 5, 7), expected);
  EXPECT_EQ((*second)->Stats()->updates_applied, (*straight)->Stats()->updates_applied);
}

TEST(PolicyClientTest, RollbackReportsTheUpdatesThatRemainAndNamesAnUnknownVersion) {
  FakePolicyServer server({.spec = FakeSpec()});
  auto client = GrpcPolicyClient::Connect(Options(server.address()), Session());
  ASSERT_TRUE(client.ok());
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  Drive(**client, 6);
  EXPECT_THAT(std::string((*client)->RollbackAdapter(9).status().message()),
              HasSubstr("no update 9"));
  EXPECT_EQ(*(*client)->RollbackAdapter(0), 0u);
  EXPECT_EQ((*client)->Stats()->adapter_distance, 0);
}

TEST(PolicyClientTest, AbsentServerIsNamedWithTheRemedy) {
  PolicyClientOptions options = Options("127.0.0.1:1");
  options.connect_timeout_s = 0.3;
  const auto client = GrpcPolicyClient::Connect(options, Session());
  EXPECT_EQ(client.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(client.status().message()),
              HasSubstr("no policy server answers at 127.0.0.1:1"));
  EXPECT_THAT(std::string(client.status().message()), HasSubstr("robostress serve"));
}

TEST(PolicyClientTest, MalformedAddressIsRefused) {
  for (const char* address : {"", "localhost", ":5000", "host:"}) {
    EXPECT_EQ(GrpcPolicyClient::Connect(Options(address), Session()).status().code(),
              absl::StatusCode::kInvalidArgument)
        << address;
  }
}

TEST(PolicyClientTest, UnknownPolicyListsTheKnownOnes) {
  FakePolicyServer server({.spec = FakeSpec()});
  RequestedSession session = Session();
  session.policy = "pi9";
  const auto client = GrpcPolicyClient::Connect(Options(server.address()), session);
  EXPECT_EQ(client.status().code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(client.status().message()),
              HasSubstr("unknown policy 'pi9'; known: fake"));
}

TEST(PolicyClientTest, HangingServerEndsInADeadline) {
  FakePolicyServer server({.spec = FakeSpec(), .answer_predictions = false});
  PolicyClientOptions options = Options(server.address());
  options.call_timeout_s = 3;
  auto client = GrpcPolicyClient::Connect(options, Session());
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  const absl::StatusOr<PredictedChunk> prediction = (*client)->Predict(Observe(), 0);
  EXPECT_EQ(prediction.status().code(), absl::StatusCode::kDeadlineExceeded);
  EXPECT_THAT(std::string(prediction.status().message()),
              HasSubstr("did not answer on the Predict stream"));
}

TEST(PolicyClientTest, SessionOutlivesAFailedPrediction) {
  FakePolicyServer server({.spec = FakeSpec(), .fail_predict_at = 2});
  auto client = GrpcPolicyClient::Connect(Options(server.address()), Session());
  ASSERT_TRUE(client.ok());
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  EXPECT_TRUE((*client)->Predict(Observe(), 0).ok());
  const absl::StatusOr<PredictedChunk> failed = (*client)->Predict(Observe(), 1);
  EXPECT_EQ(failed.status().code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(failed.status().message()), HasSubstr("told to fail"));
  EXPECT_TRUE((*client)->Predict(Observe(), 1).ok());
}

TEST(PolicyClientTest, LostServerIsReportedOnEveryCall) {
  auto server = std::make_unique<FakePolicyServer>(FakeServerOptions{.spec = FakeSpec()});
  auto client = GrpcPolicyClient::Connect(Options(server->address()), Session());
  ASSERT_TRUE(client.ok());
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  absl::StatusOr<PredictedChunk> prediction = (*client)->Predict(Observe(), 0);
  ASSERT_TRUE(prediction.ok());
  server.reset();
  EXPECT_FALSE((*client)->SendFeedback(Execute(1, *prediction, 0)).ok());
  const absl::Status again = (*client)->Predict(Observe(), 1).status();
  EXPECT_EQ(again.code(), absl::StatusCode::kUnavailable) << again;
  EXPECT_FALSE((*client)->Stats().ok());
}

TEST(PolicyClientTest, RefusesGapsInTheSequenceAndForeignShapesBeforeSending) {
  FakePolicyServer server({.spec = FakeSpec()});
  auto client = GrpcPolicyClient::Connect(Options(server.address()), Session());
  ASSERT_TRUE(client.ok());
  EXPECT_EQ((*client)->Predict(Observe(), 0).status().code(),
            absl::StatusCode::kFailedPrecondition);
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  const absl::StatusOr<PredictedChunk> prediction = (*client)->Predict(Observe(), 0);
  ASSERT_TRUE(prediction.ok());
  EXPECT_THAT(std::string((*client)->SendFeedback(Execute(2, *prediction, 0)).message()),
              HasSubstr("feedback sequence is 2, must be 1"));
  Observation foreign = Observe();
  foreign.proprioception.resize(8);
  foreign.proprioception.setZero();
  EXPECT_THAT(std::string((*client)->Predict(foreign, 0).status().message()),
              HasSubstr("proprioception has 8 values"));
  EXPECT_TRUE((*client)->SendFeedback(Execute(1, *prediction, 0)).ok());
}

TEST(PolicyClientTest, PredictionOfTheWrongShapeIsAnError) {
  FakePolicyServer server({.spec = FakeSpec(), .wrong_horizon = 3});
  auto client = GrpcPolicyClient::Connect(Options(server.address()), Session());
  ASSERT_TRUE(client.ok());
  ASSERT_TRUE((*client)->StartEpisode({0, 0}).ok());
  EXPECT_THAT(std::string((*client)->Predict(Observe(), 0).status().message()),
              HasSubstr("actions is 3 x 3, must be 4 x 3"));
}

TEST(PolicyClientTest, ServerInfoListsThePolicies) {
  FakePolicyServer server({.spec = FakeSpec()});
  const absl::StatusOr<ServerInfo> info = GetServerInfo(Options(server.address()));
  ASSERT_TRUE(info.ok()) << info.status();
  ASSERT_EQ(info->policies.size(), 1u);
  EXPECT_EQ(info->policies[0].name, "fake");
  EXPECT_EQ(info->max_sessions, 8);
}

}  // namespace
}  // namespace robostress
