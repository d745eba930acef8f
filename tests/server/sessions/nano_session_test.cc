#include <gtest/gtest.h>

#include <thread>

#include "absl/strings/str_cat.h"
#include "common/rpc/policy_client.h"
#include "server/inference/torch_threads.h"
#include "server/sessions/read_spec.h"
#include "server/sessions/session.h"
#include "server/wire/grpc/policy_service.h"
#include "tests/adapter/toy_arm.h"
#include "tests/server/serving_load.h"

namespace robostress {
namespace {

class NanoSession : public ::testing::Test {
 protected:
  NanoSession() : adaptation_(1), inference_(BatcherOptions{1}) {
    UseOneTorchThread();
    auto policy = LoadFlowPolicy("nano:random");
    EXPECT_TRUE(policy.ok()) << policy.status();
    policy_ = *std::move(policy);
  }

  std::shared_ptr<Session> Open(const std::string& method,
                                const std::vector<std::string>& overrides) {
    SessionSpec spec;
    spec.suite = "tabletop_goal";
    spec.scenario = "clean";
    spec.policy = policy_->spec().name;
    spec.method = *MakeMethod(method, overrides);
    auto session = Session::Create(spec, {policy_, &adaptation_, &inference_}, ++owner_);
    EXPECT_TRUE(session.ok()) << session.status();
    return *session;
  }

  // The actions of `chunks` chunks; images and state change with the chunk.
  Eigen::MatrixXf Drive(Session& session, int chunks) {
    const PolicySpec& spec = policy_->spec();
    ToyArm arm(0.4);
    Eigen::MatrixXf actions(chunks * spec.horizon, spec.action_dim);
    EXPECT_TRUE(session.StartEpisode({0, 0}, 0).ok());
    for (int i = 0; i < chunks; ++i) {
      Observation observation;
      observation.instruction = "put the bowl on the plate";
      for (const std::string& camera : spec.cameras) {
        Image image{spec.image_width, spec.image_height, {}};
        image.data.resize(size_t{3} * image.width * image.height, static_cast<uint8_t>(16 * i));
        observation.views.push_back({camera, image});
      }
      observation.proprioception = Eigen::VectorXf::Constant(spec.state_dim, 0.01f * i);
      const auto prediction = session.Predict(
          std::make_shared<const Observation>(std::move(observation)), {{0, 0}, i}, i);
      EXPECT_TRUE(prediction.ok()) << prediction.status();
      actions.middleRows(spec.horizon * i, spec.horizon) = prediction->actions;
      ExecutedChunk executed = arm.Execute(*prediction, spec.execute_steps);
      executed.sequence = i + 1;
      executed.chunk = i;
      const auto feedback = session.Feedback(executed);
      EXPECT_TRUE(feedback.ok()) << feedback.status();
    }
    return actions;
  }

  AdaptationLoop adaptation_;
  Batcher inference_;
  std::shared_ptr<const FlowPolicy> policy_;
  uint64_t owner_ = 0;
};

TEST_F(NanoSession, OursEqualsBaseBitForBitUntilTheFirstUpdateAndAtLearningRateZero) {
  const std::vector<std::string> often{"buffer_chunks=4", "update_interval=1", "batch=4"};
  std::vector<std::string> zero = often, rate = often;
  zero.push_back("learning_rate=0");
  rate.push_back("learning_rate=0.001");
  const Eigen::MatrixXf base = Drive(*Open("base", {}), 8);
  const auto frozen = Open("ours", zero), ours = Open("ours", rate);
  EXPECT_EQ(Drive(*frozen, 8), base);
  EXPECT_EQ(frozen->Counters()->stats.updates_applied, 5u);
  const Eigen::MatrixXf adapted = Drive(*ours, 8);
  const int first = 4 * policy_->spec().horizon;
  EXPECT_EQ(adapted.topRows(first), base.topRows(first));
  EXPECT_NE(adapted.bottomRows(first), base.bottomRows(first));
  EXPECT_GT(ours->Counters()->stats.adapter_distance, 0);
}

// One computing thread: what the others ask for meanwhile shares passes with it.
TEST_F(NanoSession, ALockstepSessionHasTheSameBitsAloneAndInBatchesWithFifteenOthers) {
  const std::vector<std::string> often{"buffer_chunks=4", "update_interval=2", "batch=4",
                                       "learning_rate=0.001"};
  const Eigen::MatrixXf alone = Drive(*Open("ours", often), 8);
  std::vector<std::shared_ptr<Session>> sessions;
  for (int i = 0; i < 16; ++i) sessions.push_back(Open("ours", often));
  const uint64_t batches = inference_.counters().batches,
                 predictions = inference_.counters().predictions;
  std::vector<Eigen::MatrixXf> actions(sessions.size());
  std::vector<std::thread> threads;
  for (size_t i = 0; i < sessions.size(); ++i)
    threads.emplace_back([&, i] { actions[i] = Drive(*sessions[i], 8); });
  for (std::thread& thread : threads) thread.join();
  for (size_t i = 0; i < sessions.size(); ++i) EXPECT_EQ(actions[i], alone) << i;
  EXPECT_LT(inference_.counters().batches - batches,
            inference_.counters().predictions - predictions);
}

TEST_F(NanoSession, LoraSitsOnAllSevenProjectionsOfEveryExpertLayer) {
  EXPECT_GT(policy_->lora_targets().size(), 0u);
  EXPECT_EQ(policy_->lora_targets().size() % 7, 0u);
}

TEST(NanoServer, TakesTheGreatestAdapterThatItsCapsAllowAndNothingTwiceAsLong) {
  const auto server = *PolicyServer::Start({}, {*LoadFlowPolicy("nano:random")});
  PolicyClientOptions address;
  address.address = absl::StrCat("127.0.0.1:", server->port());
  SessionSpec spec;
  spec.suite = spec.scenario = "greatest";
  spec.policy = "nano:random";
  spec.method =
      *MakeMethod("ours", {"rank=16", "batch=8", "update_interval=128", "buffer_chunks=128"});
  const auto client = *GrpcPolicyClient::Connect(address, RequestOf(spec));
  ASSERT_TRUE(client->StartEpisode({0, 0}).ok());
  Observation observation = BlankObservation(GetServerInfo(address)->policies[0]);
  for (int word = 0; word < 12; ++word)  // as many as it reads
    observation.instruction += " bowl";
  ToyArm arm(0.6);
  for (int i = 0; i < 130; ++i) {
    const auto prediction = client->Predict(observation, i);
    ASSERT_TRUE(prediction.ok()) << prediction.status();
    ExecutedChunk executed = arm.Execute(*prediction, 5);
    executed.sequence = client->last_feedback_sequence() + 1;
    executed.chunk = i;
    ASSERT_TRUE(client->SendFeedback(executed).ok());
  }
  EXPECT_EQ(client->Stats()->updates_applied, 1u) << "with moments";
  const std::string exported = client->ExportAdapter()->safetensors;
  const auto taken = client->ImportAdapter(exported);
  EXPECT_TRUE(taken.ok()) << exported.size() << " bytes: " << taken.status();
  const absl::Status refused = client->ImportAdapter(exported + exported).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kResourceExhausted) << refused;
}

}  // namespace
}  // namespace robostress
