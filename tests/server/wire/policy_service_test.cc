#include "server/wire/grpc/policy_service.h"

#include <gmock/gmock.h>
#include <grpcpp/generic/generic_stub.h>
#include <grpcpp/grpcpp.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <functional>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/rollout/refusal.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_specs.h"
#include "common/rpc/policy_client.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/sessions/read_spec.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class PolicyServiceTest : public ::testing::Test {
 protected:
  PolicyServiceTest() { Start(absl::Minutes(15)); }

  void Start(absl::Duration abandoned_after) {
    PolicyServerOptions options;
    options.max_sessions = 3;
    options.abandoned_after = abandoned_after;
    auto server = PolicyServer::Start(options, {std::make_shared<FakePolicy>()});
    EXPECT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
  }

  PolicyClientOptions Address() const {
    PolicyClientOptions options;
    options.address = absl::StrCat("127.0.0.1:", server_->port());
    return options;
  }
  std::unique_ptr<GrpcPolicyClient> Connect(const SessionSpec& spec) const {
    auto client = GrpcPolicyClient::Connect(Address(), RequestOf(spec));
    EXPECT_TRUE(client.ok()) << client.status();
    return *std::move(client);
  }

  std::unique_ptr<PolicyServer> server_;
};

// All actions of `chunks` chunks over the wire.
Eigen::MatrixXf Drive(GrpcPolicyClient& client, int chunks) {
  ToyArm arm(0.6);
  Eigen::MatrixXf actions(chunks * 10, 7);
  EXPECT_TRUE(client.StartEpisode({0, 0}).ok());
  for (int i = 0; i < chunks; ++i) {
    Observation observation = FakePolicy::MakeObservation(i);
    observation.proprioception = arm.state().tool.p_base_tool.cast<float>();
    const auto prediction = client.Predict(observation, i);
    EXPECT_TRUE(prediction.ok()) << prediction.status();
    actions.middleRows(10 * i, 10) = prediction->actions;
    ExecutedChunk executed = arm.Execute(*prediction, 5);
    executed.sequence = client.last_feedback_sequence() + 1;
    executed.chunk = i;
    const absl::Status sent = client.SendFeedback(executed);
    EXPECT_TRUE(sent.ok()) << sent;
  }
  return actions;
}

TEST_F(PolicyServiceTest, LockstepClientsComeBackFromAnOverloadedServerAndMissNothing) {
  PolicyServerOptions options;
  options.threads = 1;
  options.queue_capacity = 1;
  auto server = PolicyServer::Start(options, {std::make_shared<FakePolicy>()});
  ASSERT_TRUE(server.ok()) << server.status();
  server_ = *std::move(server);
  const SessionSpec spec = Spec("ours", {"learning_rate=0.01"});
  const Eigen::MatrixXf expected = Drive(*Connect(spec), 20);
  std::vector<std::thread> threads;
  for (int i = 0; i < 8; ++i)
    threads.emplace_back([&] { EXPECT_EQ(Drive(*Connect(spec), 20), expected); });
  for (std::thread& thread : threads) thread.join();
}

TEST_F(PolicyServiceTest, GivesOverTheWireTheBitsOfALocalSession) {
  const SessionSpec spec = Spec("ours", {"learning_rate=0.01"});
  const auto remote = Connect(spec);
  const Eigen::MatrixXf actions = Drive(*remote, 50);
  EXPECT_EQ(remote->Stats()->updates_applied, 3u);
  EXPECT_GT(remote->Stats()->adapter_distance, 0);

  Rig rig;
  Client local(rig.Open(spec));
  local.StartEpisode(0, 0);
  for (int i = 0; i < 50; ++i) {
    ASSERT_EQ(actions.middleRows(10 * i, 10), local.RunChunk().actions) << "chunk " << i;
  }
  EXPECT_EQ(remote->ExportAdapter()->safetensors, ExportOf(local.session()));
}

TEST_F(PolicyServiceTest, ImportsWhatItExported) {
  const SessionSpec spec = Spec("ours", {"learning_rate=0.01"});
  const auto first = Connect(spec), second = Connect(spec);
  Drive(*first, 40);
  const auto exported = first->ExportAdapter();
  ASSERT_TRUE(exported.ok()) << exported.status();
  const auto sequence = second->ImportAdapter(exported->safetensors);
  ASSERT_TRUE(sequence.ok()) << sequence.status();
  EXPECT_EQ(*sequence, 40u);
  EXPECT_EQ(second->ExportAdapter()->safetensors, exported->safetensors);
  EXPECT_EQ(*second->RollbackAdapter(0), 0u);
  EXPECT_EQ(second->Stats()->adapter_distance, 0);
}

TEST_F(PolicyServiceTest, CountsStepsThatNoRobotCanShow) {
  const auto client = Connect(Spec("ours"));
  ASSERT_TRUE(client->StartEpisode({0, 0}).ok());
  const auto prediction = client->Predict(FakePolicy::MakeObservation(0), 0);
  ASSERT_TRUE(prediction.ok()) << prediction.status();
  ExecutedChunk executed = ToyArm(0.6).Execute(*prediction, 5);
  executed.steps[2].before.q[0] = 1e30;
  executed.sequence = 1;
  ASSERT_TRUE(client->SendFeedback(executed).ok());
  v1::GetStatsRequest request;
  request.set_session_id(client->session_id());
  v1::GetStatsResponse stats;
  grpc::ClientContext context;
  const auto stub = v1::PolicyService::NewStub(
      grpc::CreateChannel(Address().address, grpc::InsecureChannelCredentials()));
  ASSERT_TRUE(client->Stats().ok()) << "the feedback is in";
  ASSERT_TRUE(stub->GetStats(&context, request, &stats).ok());
  EXPECT_EQ(stats.steps_impossible(),
            (*server_->sessions().Use(client->session_id()))->CountersNow().steps_impossible);
  EXPECT_GT(stats.steps_impossible(), 0u);
}

TEST_F(PolicyServiceTest, AnAdapterLargerThanAMessageIsRefusedWithTheFlag) {
  PolicyServerOptions options;
  options.max_message_mib = 1;
  options.caps.max_buffer_chunks = 4096;
  auto server = PolicyServer::Start(options, {std::make_shared<FakePolicy>()});
  ASSERT_TRUE(server.ok()) << server.status();
  server_ = *std::move(server);
  const auto remote = Connect(Spec("ours", {"buffer_chunks=4096"}));
  auto session = server_->sessions().Use(remote->session_id());
  ASSERT_TRUE(session.ok()) << session.status();
  Client client(session->session());
  client.StartEpisode(0, 0);
  client.RunChunks(1500);
  const absl::Status refused = remote->ExportAdapter().status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("start it with --max-message-mib 2"));
}

TEST_F(PolicyServiceTest, SaysWhatItServes) {
  const auto info = GetServerInfo(Address());
  ASSERT_TRUE(info.ok()) << info.status();
  ASSERT_EQ(info->policies.size(), 1u);
  EXPECT_EQ(info->policies[0].name, "fake");
  EXPECT_EQ(info->max_sessions, 3);
}

TEST_F(PolicyServiceTest, RefusesAnUnknownPolicyAndOneSessionTooMany) {
  SessionSpec spec = Spec("base");
  spec.policy = "pi9";
  EXPECT_THAT(std::string(GrpcPolicyClient::Connect(Address(), RequestOf(spec)).status().message()),
              HasSubstr("policy 'pi9' is not served here; served: fake"));
  const auto a = Connect(Spec("base")), b = Connect(Spec("base")), c = Connect(Spec("base"));
  const absl::Status full = GrpcPolicyClient::Connect(Address(), RequestOf(Spec("base"))).status();
  EXPECT_TRUE(absl::IsResourceExhausted(full)) << full;
  EXPECT_GT(RetryAfter(full), absl::Seconds(1));  // the first one, never served, makes room then
  EXPECT_LE(RetryAfter(full), absl::Seconds(30));
}

TEST_F(PolicyServiceTest, ClosingASessionMakesRoom) {
  for (int i = 0; i < 10; ++i) {
    const auto client = Connect(Spec("ours"));
    Drive(*client, 1);
  }
  EXPECT_EQ(GetServerInfo(Address())->open_sessions, 0);
}

TEST_F(PolicyServiceTest, AnAbandonedSessionMakesRoomAndSaysSoToItsClient) {
  Start(absl::ZeroDuration());
  const auto abandoned = Connect(Spec("base")), used = Connect(Spec("base"));
  const auto last = Connect(Spec("base"));
  Drive(*used, 1);
  Drive(*last, 1);
  const auto fourth = Connect(Spec("base"));
  EXPECT_EQ(GetServerInfo(Address())->open_sessions, 3);
  EXPECT_THAT(std::string(abandoned->StartEpisode({0, 0}).message()),
              HasSubstr("is not open here"));
  Drive(*used, 1);
  Drive(*fourth, 1);
}

TEST_F(PolicyServiceTest, AnswersHealthChecks) {
  // No generated code of the health protocol is installed: an empty request asks for the whole
  // server, and the answer is one enum.
  grpc::GenericStub stub(
      grpc::CreateChannel(Address().address, grpc::InsecureChannelCredentials()));
  grpc::ClientContext context;
  context.set_deadline(std::chrono::system_clock::now() + std::chrono::seconds(20));
  context.set_wait_for_ready(true);
  grpc::CompletionQueue queue;
  const grpc::Slice empty;
  auto call = stub.PrepareUnaryCall(&context, "/grpc.health.v1.Health/Check",
                                    grpc::ByteBuffer(&empty, 1), &queue);
  call->StartCall();
  grpc::ByteBuffer response;
  grpc::Status status;
  call->Finish(&response, &status, nullptr);
  void* tag = nullptr;
  bool ok = false;
  ASSERT_TRUE(queue.Next(&tag, &ok));
  ASSERT_TRUE(status.ok()) << status.error_message();
  grpc::Slice slice;
  ASSERT_TRUE(response.DumpToSingleSlice(&slice).ok());
  ASSERT_EQ(slice.size(), 2u);
  EXPECT_EQ(slice.begin()[1], 1);  // field 1 = SERVING
}

TEST_F(PolicyServiceTest, StopAnswersWhatIsUnderWayAndRefusesTheRest) {
  const auto client = Connect(Spec("base"));
  Drive(*client, 2);
  server_->Stop(absl::Seconds(5));
  EXPECT_FALSE(client->Predict(FakePolicy::MakeObservation(0), 2).ok());
}

TEST(PolicyServer, RefusesSettingsOfBatchesAndUpdatesThatMakeNoSense) {
  const auto message = [](const std::function<void(PolicyServerOptions&)>& change) {
    PolicyServerOptions options;
    change(options);
    return std::string(
        PolicyServer::Start(options, {std::make_shared<FakePolicy>()}).status().message());
  };
  EXPECT_THAT(message([](auto& o) { o.max_batch = 0; }), HasSubstr("--max-batch is 0"));
  EXPECT_THAT(message([](auto& o) { o.queue_capacity = 0; }), HasSubstr("--queue-capacity is 0"));
  EXPECT_THAT(message([](auto& o) { o.update_share = 0; }), HasSubstr("--update-share is 0"));
  EXPECT_THAT(message([](auto& o) { o.update_share = std::nan(""); }), HasSubstr("--update-share"));
  EXPECT_THAT(message([](auto& o) { o.update_nice = 20; }), HasSubstr("--update-nice is 20"));
  EXPECT_THAT(message([](auto& o) { o.cores = -1; }), HasSubstr("--cores is -1"));
  EXPECT_THAT(message([](auto& o) { o.batch_window = absl::Seconds(11); }),
              HasSubstr("--batch-window-ms is 11000"));
}

TEST_F(PolicyServiceTest, AnAsynchronousStreamSurvivesAnErrorAndSaysHowPredictionsWereServed) {
  SessionSpec spec = Spec("base");
  spec.mode = ExecutionMode::kAsync;
  const auto channel = grpc::CreateChannel(Address().address, grpc::InsecureChannelCredentials());
  const auto stub = v1::PolicyService::NewStub(channel);
  v1::OpenSessionRequest open;
  *open.mutable_spec() = ToProto(RequestOf(spec));
  v1::OpenSessionResponse opened;
  grpc::ClientContext open_context, episode_context, predict_context;
  ASSERT_TRUE(stub->OpenSession(&open_context, open, &opened).ok());
  v1::StartEpisodeRequest episode;
  episode.set_session_id(opened.session_id());
  v1::StartEpisodeResponse started;
  ASSERT_TRUE(stub->StartEpisode(&episode_context, episode, &started).ok());
  const auto stream = stub->Predict(&predict_context);
  v1::PredictRequest request;
  request.set_session_id(opened.session_id());
  *request.mutable_observation() = ToProto(FakePolicy::MakeObservation(0));
  v1::PredictResponse response;
  ASSERT_TRUE(stream->Write(request));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_FALSE(response.has_refusal());
  EXPECT_GT(response.compute_ms(), 0);
  EXPECT_EQ(response.batch_size(), 1u);
  request.mutable_observation()->clear_proprioception();  // an error is an answer here
  ASSERT_TRUE(stream->Write(request));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_EQ(response.refusal().code(), 3);
  *request.mutable_observation() = ToProto(FakePolicy::MakeObservation(0));
  ASSERT_TRUE(stream->Write(request));
  ASSERT_TRUE(stream->Read(&response));
  EXPECT_FALSE(response.has_refusal());
}

TEST(PolicyServer, SaysWhenThePortIsTaken) {
  PolicyServerOptions options;
  auto first = PolicyServer::Start(options, {std::make_shared<FakePolicy>()});
  ASSERT_TRUE(first.ok());
  options.listen = absl::StrCat("127.0.0.1:", (*first)->port());
  EXPECT_THAT(
      std::string(
          PolicyServer::Start(options, {std::make_shared<FakePolicy>()}).status().message()),
      HasSubstr("cannot listen on 127.0.0.1:"));
}

}  // namespace
}  // namespace robostress
