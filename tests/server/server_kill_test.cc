// The end of the server at any moment: `robostress serve` is killed with SIGKILL again and again
// while a client learns, and started again on the same folder. What it has learned at the end must
// be that of a server that was never killed, in every bit.
//
//   ROBOSTRESS_KILLS=200 build/release/test_bin/server_kill_test

#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/method_options.h"
#include "common/random.h"
#include "common/rpc/policy_client.h"
#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// A server process on a folder; killed and started again on the port that it had.
class ServeProcess {
 public:
  explicit ServeProcess(std::string folder) : folder_(std::move(folder)) {}
  ~ServeProcess() { Kill(); }

  bool Start() {
    const std::string port_file = folder_ + ".port";
    fs::remove(port_file);
    const std::string listen = absl::StrCat("127.0.0.1:", port_);
    pid_ = fork();
    if (pid_ == 0) {
      if (std::freopen("/dev/null", "w", stdout) == nullptr) _exit(126);
      if (std::freopen((folder_ + ".log").c_str(), "a", stderr) == nullptr) _exit(126);
      execl(SERVE_PROGRAM, SERVE_PROGRAM, "--policy", "nano:random", "--threads", "1",
            "--state-dir", folder_.c_str(), "--snapshot-records", "23", "--listen", listen.c_str(),
            "--port-file", port_file.c_str(), nullptr);
      _exit(127);
    }
    for (int i = 0; i < 3000; ++i) {
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
      if (std::ifstream(port_file) >> port_) return true;
    }
    return false;
  }
  void Kill() {
    if (pid_ <= 0) return;
    kill(pid_, SIGKILL);
    waitpid(pid_, nullptr, 0);
    pid_ = -1;
  }
  std::string address() const { return absl::StrCat("127.0.0.1:", port_); }

 private:
  const std::string folder_;
  pid_t pid_ = -1;
  int port_ = 0;
};

SessionSpec LearningSession() {
  SessionSpec spec;
  spec.suite = "tabletop_goal";
  spec.scenario = "heavy_payload";
  spec.policy = "nano:random";
  spec.method = *MakeMethod("ours", {"learning_rate=0.001", "buffer_chunks=8", "update_interval=2",
                                     "batch=4", "track_intent=false"});
  return spec;
}

// A robot that observes what it did, so that one bit of difference shows in everything later.
class Robot {
 public:
  explicit Robot(GrpcPolicyClient* client) : client_(client) {}

  absl::Status RunChunk() {
    const PolicySpec& spec = client_->spec();
    if (chunks_ % 20 == 0) {
      const absl::Status started = client_->StartEpisode({chunks_ / 200, chunks_ / 20});
      if (!started.ok()) return started;
    }
    const int chunk = chunks_ % 20;
    Observation observation;
    observation.instruction = "put the bowl on the plate";
    for (const std::string& camera : spec.cameras) {
      Image image{spec.image_width, spec.image_height, {}};
      image.data.resize(size_t{3} * image.width * image.height, static_cast<uint8_t>(chunks_));
      observation.views.push_back({camera, image});
    }
    observation.proprioception = Eigen::VectorXf::Zero(spec.state_dim);
    observation.proprioception.head<3>() = arm_.state().tool.p_base_tool.cast<float>();
    const auto prediction = client_->Predict(observation, chunk);
    if (!prediction.ok()) return prediction.status();
    ExecutedChunk executed = arm_.Execute(*prediction, spec.execute_steps);
    executed.sequence = client_->last_feedback_sequence() + 1;
    executed.task = chunks_ / 200;
    executed.episode = chunks_ / 20;
    executed.chunk = chunk;
    ++chunks_;
    return client_->SendFeedback(std::move(executed));
  }
  int chunks() const { return chunks_; }

 private:
  GrpcPolicyClient* client_;
  ToyArm arm_{0.6};
  int chunks_ = 0;
};

std::unique_ptr<GrpcPolicyClient> Connect(const ServeProcess& server) {
  PolicyClientOptions options;
  options.address = server.address();
  options.reconnect_timeout_s = 60;
  auto client = GrpcPolicyClient::Connect(options, LearningSession());
  EXPECT_TRUE(client.ok()) << client.status();
  return client.ok() ? *std::move(client) : nullptr;
}

TEST(ServerKill, ContinuesBitForBitAfterBeingKilledAtAnyMoment) {
  const char* wanted = std::getenv("ROBOSTRESS_KILLS");
  const int kills = wanted == nullptr ? 5 : std::atoi(wanted);
  const fs::path root = fs::path(::testing::TempDir()) / absl::StrCat("kills-", getpid());
  fs::create_directories(root);
  ServeProcess killed((root / "killed").string()), straight((root / "straight").string());
  ASSERT_TRUE(killed.Start());
  const auto client = Connect(killed);
  ASSERT_NE(client, nullptr);
  Robot robot(client.get());
  ASSERT_TRUE(robot.RunChunk().ok());

  std::atomic<bool> done{false};
  std::thread killer([&] {
    RandomStream moments(StreamKey("kills").With(kills));
    for (int i = 0; i < kills; ++i) {
      std::this_thread::sleep_for(
          std::chrono::microseconds(static_cast<int64_t>(moments.Uniform(1e3, 4e5))));
      killed.Kill();
      if (!killed.Start()) break;
    }
    done = true;
  });
  absl::Status status;
  while (status.ok() && (!done || robot.chunks() < 60)) status = robot.RunChunk();
  killer.join();
  ASSERT_TRUE(status.ok()) << status;
  const auto learned = client->ExportAdapter();
  ASSERT_TRUE(learned.ok()) << learned.status();

  ASSERT_TRUE(straight.Start());
  const auto reference = Connect(straight);
  ASSERT_NE(reference, nullptr);
  Robot twin(reference.get());
  while (twin.chunks() < robot.chunks()) ASSERT_TRUE(twin.RunChunk().ok());
  const auto expected = reference->ExportAdapter();
  ASSERT_TRUE(expected.ok()) << expected.status();
  EXPECT_EQ(learned->feedback_sequence, expected->feedback_sequence);
  EXPECT_EQ(learned->updates_applied, expected->updates_applied);
  EXPECT_GT(learned->updates_applied, 10u);
  EXPECT_TRUE(learned->safetensors == expected->safetensors)
      << "LoRA, Adam, buffer or counters differ in a bit";
  std::printf(
      "%d kills, %llu resumed sessions, %d chunks, %llu updates, %zu bytes of state equal\n", kills,
      static_cast<unsigned long long>(client->resumes()), robot.chunks(),
      static_cast<unsigned long long>(learned->updates_applied), learned->safetensors.size());
  fs::remove_all(root);
}

}  // namespace
}  // namespace robostress
