// The paper's loop on a real arm, end to end: an emulated Piper over its CAN frames, the client's
// control loop, the feedback stream over gRPC, and a server that learns in joint space.

#include <gtest/gtest.h>
#include <torch/torch.h>

#include "absl/strings/str_cat.h"
#include "robot_client/emulator/study/study_unit.h"
#include "robot_client/policy_connection.h"
#include "server/policies/nano/nano_policy.h"
#include "server/wire/grpc/policy_service.h"

namespace robostress::piper {
namespace {

// nano with its Piper's interface and random weights, in small; its actions are small too.
std::shared_ptr<const FlowPolicy> TinyPiperPolicy() {
  NanoConfig config;
  config.cameras = {"base", "wrist"};
  config.image_size = 16;
  config.conv_channels = {4, 8};
  config.state_dim = 7;
  config.displacement_channels = 6;
  config.execute_steps = 10;
  config.layers = 2;
  config.heads = 2;
  config.head_dim = 8;
  config.prefix_width = config.expert_width = 16;
  config.prefix_mlp = config.expert_mlp = 24;
  NanoModel model = RandomNanoModel(config, 4);
  std::fill(model.actions.std.begin(), model.actions.std.end(), 0.02f);
  model.actions.mean[6] = 0.05f;
  auto policy = MakeNanoPolicy(std::move(model), "tiny", "tiny");
  EXPECT_TRUE(policy.ok()) << policy.status();
  return *std::move(policy);
}

// The session as the arm has it, with a note of what had been reported when a version answered.
class Watched : public PolicyEndpoint {
 public:
  explicit Watched(PolicyEndpoint* policy) : policy_(policy) {}
  const PolicySpec& spec() const override { return policy_->spec(); }
  absl::Status StartEpisode(const EpisodeKey& key) override { return policy_->StartEpisode(key); }
  absl::StatusOr<PredictedChunk> Predict(const Observation& observation, int chunk) override {
    auto prediction = policy_->Predict(observation, chunk);
    if (prediction.ok()) seen.push_back({sent, prediction->adapter_version});
    return prediction;
  }
  absl::Status SendFeedback(ExecutedChunk executed) override {
    for (const ExecutedStep& step : executed.steps) {
      EXPECT_EQ(step.before.q.size(), kArmJoints);
      EXPECT_EQ(step.policy_command.size(), kArmAxes);
    }
    const absl::Status status = policy_->SendFeedback(std::move(executed));
    EXPECT_TRUE(status.ok()) << status;
    ++sent;
    return status;
  }
  absl::StatusOr<SessionStats> Stats() override { return policy_->Stats(); }

  uint64_t sent = 0;
  std::vector<std::pair<uint64_t, uint64_t>> seen;  // chunks reported, adapter version

 private:
  PolicyEndpoint* const policy_;
};

TEST(JointAdaptation, UpdatesAfter32ChunksAndEveryEightFromThenOn) {
  auto server = PolicyServer::Start({}, {TinyPiperPolicy()});
  ASSERT_TRUE(server.ok()) << server.status();
  PolicyConnectionOptions connection;
  connection.server = absl::StrCat("127.0.0.1:", (*server)->port());
  connection.policy = "tiny";
  connection.robot = "piper_new";
  connection.connect_timeout_s = connection.call_timeout_s = 120;
  connection.method = *MakeMethod("ours", {"learning_rate=1e-3"});
  connection.mode = ExecutionMode::kLockstep;
  auto policy = ConnectTo(connection, 1.0 / 30)();
  ASSERT_TRUE(policy.ok()) << policy.status();
  Watched watched(policy->get());
  StudyUnit unit;
  unit.episodes = 5;
  unit.episode_s = 3.7;  // eleven chunks, the last one short
  std::vector<ArmEpisode> episodes;
  const absl::Status played = RunStudyUnit(unit, &watched, [&](const ArmEpisode& episode) {
    episodes.push_back(episode);
    return absl::OkStatus();
  });
  if (absl::IsUnavailable(played)) GTEST_SKIP() << played.message();
  ASSERT_TRUE(played.ok()) << played;
  ASSERT_GE(watched.sent, 48u);
  for (const auto& [sent, version] : watched.seen) {
    EXPECT_EQ(version, sent < 32 ? 0 : 1 + (sent - 32) / 8) << "after " << sent << " chunks";
  }
  const auto stats = watched.Stats();
  ASSERT_TRUE(stats.ok()) << stats.status();
  EXPECT_EQ(stats->feedback_chunks, watched.sent);
  EXPECT_EQ(stats->updates_applied, 1 + (watched.sent - 32) / 8);
  EXPECT_GT(stats->adapter_distance, 0);
  for (const ArmEpisode& episode : episodes) {
    EXPECT_GT(episode.residual, 0) << "episode " << episode.episode;
    EXPECT_EQ(episode.power_cycles, 0);
  }
}

}  // namespace
}  // namespace robostress::piper
