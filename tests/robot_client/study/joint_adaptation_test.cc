// The paper's loop on a real arm, end to end: an emulated Piper over its CAN frames, the client's
// control loop, the feedback stream over gRPC, and a server that learns in joint space. The server
// is a process of its own, as always: Debian 13's LibTorch exports the LLVM that Mesa must not find
// (a crash in its first shader).

#include <gtest/gtest.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/embedded_policies.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/policy_connection.h"
#include "robot_client/study/piper_player.h"
#include "tests/server/serve_process.h"

namespace robostress::piper {
namespace {

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
      EXPECT_EQ(step.before.q.size(), piper::kJoints);
      EXPECT_EQ(step.policy_command.size(), piper::kAxes);
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
  const ServeProcess server(SERVE_PROGRAM, {"--policy", kPiperPolicy});
  PolicyConnectionOptions connection;
  connection.server = server.Address("grpc");
  connection.policy = kPiperPolicy;
  connection.robot = "piper_new";
  connection.connect_timeout_s = connection.call_timeout_s = 120;
  connection.method = *MakeMethod("ours", {"learning_rate=1e-3"});
  connection.mode = ExecutionMode::kLockstep;
  auto policy = ConnectTo(connection, 1.0 / 30)();
  ASSERT_TRUE(policy.ok()) << policy.status();
  auto lent = std::make_unique<Watched>(policy->get());
  Watched& watched = *lent;
  UnitConfig unit;
  unit.robot = "piper";
  unit.suite = "piper_1_next_to_plate";
  unit.scenario = "new";
  unit.episodes = 5;
  unit.client.episode_s = 3.7;  // eleven chunks, the last one short
  unit = *ResolvePiperUnit(unit);
  PiperPlayer player(
      unit, [&]() -> absl::StatusOr<std::unique_ptr<PolicyEndpoint>> { return std::move(lent); });
  UnitRunOptions run;
  run.out = ::testing::TempDir() + "/joint_adaptation_unit";
  std::filesystem::remove_all(run.out);
  const absl::Status played = RunUnit(unit, run, player);
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
  const std::string rows = *ReadFile(run.out + "/episodes.jsonl");
  int episodes = 0;
  for (const std::string& line :
       std::vector<std::string>(absl::StrSplit(rows, '\n', absl::SkipEmpty()))) {
    const EpisodeRow row = *ParseEpisode("rows", line);
    EXPECT_GT(*row.residual, 0) << line;
    EXPECT_EQ(row.power_cycles, 0) << line;
    ++episodes;
  }
  EXPECT_EQ(episodes, 5);
}

}  // namespace
}  // namespace robostress::piper
