// The end of the server at any moment: it is killed with SIGKILL again and again while a client
// learns, and started again on the same folder and port. What it has learned at the end must be
// that of a session that never ended, in every bit.
//
//   ROBOSTRESS_KILLS=200 build/release/test_bin/server_kill_test
//
// The server is a process of its own, forked from one that is forked before any thread starts: so
// it is up within milliseconds, and a kill meets it at work.

#include <gtest/gtest.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/rpc/policy_client.h"
#include "server/sessions/read_spec.h"
#include "server/wire/grpc/policy_service.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

struct Order {
  pid_t kill = 0;  // this server; 0: start one
  int port = 0;    // 0: a free one
  char folder[256] = {};
};

// Starts and kills servers on order, in a process without threads.
class ServerForge {
 public:
  ServerForge() {
    if (pipe(orders_) != 0 || pipe(answers_) != 0) std::abort();
    if (fork() != 0) return;
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    close(orders_[1]);
    Order order;
    while (read(orders_[0], &order, sizeof order) == sizeof order) {
      int answer = 0;
      if (order.kill != 0) {
        kill(order.kill, SIGKILL);
        waitpid(order.kill, nullptr, 0);
      } else if ((answer = fork()) == 0) {
        Serve(order);
      }
      if (write(answers_[1], &answer, sizeof answer) != sizeof answer) break;
    }
    _exit(0);
  }

  // Returns the port when the server listens; 0: it does not.
  int Start(const std::string& folder, int port) {
    Order order;
    order.port = port;
    folder.copy(order.folder, sizeof order.folder - 1);
    Send(order);
    const int first = Receive(), second = Receive();  // of the forge and of the server
    server_ = std::max(first, second);                // process numbers exceed
    return -std::min(first, second);                  // negated ports
  }
  void Kill() {
    Order order;
    order.kill = server_;
    Send(order);
    Receive();
  }

 private:
  [[noreturn]] void Serve(const Order& order) {
    prctl(PR_SET_PDEATHSIG, SIGKILL);
    PolicyServerOptions options;
    options.listen = absl::StrCat("127.0.0.1:", order.port);
    options.threads = 1;
    options.state_dir = order.folder;
    options.snapshot_records = 23;
    options.caps.min_update_interval = 1;
    const auto server = PolicyServer::Start(options, {std::make_shared<FakePolicy>()});
    const int port = server.ok() ? -(*server)->port() : 0;
    if (write(answers_[1], &port, sizeof port) != sizeof port) _exit(1);
    while (true) pause();
  }
  void Send(const Order& order) {
    if (write(orders_[1], &order, sizeof order) != sizeof order) std::abort();
  }
  int Receive() {
    int answer = 0;
    if (read(answers_[0], &answer, sizeof answer) != sizeof answer) std::abort();
    return answer;
  }

  int orders_[2], answers_[2];
  pid_t server_ = 0;
};

ServerForge* forge = nullptr;

SessionSpec LearningSession() {
  return Spec("ours", {"learning_rate=0.01", "buffer_chunks=8", "update_interval=2"});
}

Observation Observe(const ToyArm& arm, int chunk) {
  Observation observation = FakePolicy::MakeObservation(chunk);
  observation.proprioception = arm.state().tool.p_base_tool.cast<float>();
  return observation;
}

// One chunk of a robot that sees what it did, so that a bit of difference shows in all that
// follows.
template <class Start, class Predict, class Send>
absl::Status RunChunk(ToyArm& arm, int index, Start start, Predict predict, Send send) {
  const int task = index / 300, episode = index / 20, chunk = index % 20;
  if (chunk == 0) {
    if (absl::Status status = start(task, episode); !status.ok()) return status;
  }
  const absl::StatusOr<PredictedChunk> prediction =
      predict(Observe(arm, chunk), task, episode, chunk);
  if (!prediction.ok()) return prediction.status();
  ExecutedChunk executed = arm.Execute(*prediction, 5);
  executed.sequence = static_cast<uint64_t>(index) + 1;
  executed.task = task;
  executed.episode = episode;
  executed.chunk = chunk;
  return send(executed);
}

TEST(ServerKill, ContinuesBitForBitAfterBeingKilledAtAnyMoment) {
  const char* wanted = std::getenv("ROBOSTRESS_KILLS");
  const int kills = wanted == nullptr ? 12 : std::atoi(wanted);
  const fs::path folder = fs::path(::testing::TempDir()) / absl::StrCat("kills-", getpid());
  fs::create_directories(folder);
  const int port = forge->Start(folder.string(), 0);
  ASSERT_GT(port, 0);
  PolicyClientOptions options;
  options.address = absl::StrCat("127.0.0.1:", port);
  options.reconnect_timeout_s = 60;
  auto client = GrpcPolicyClient::Connect(options, RequestOf(LearningSession()));
  ASSERT_TRUE(client.ok()) << client.status();

  std::atomic<int> chunks{0};
  std::atomic<bool> done{false};
  std::thread killer([&] {
    RandomStream moments(StreamKey("kills").With(int64_t{kills}));
    for (int i = 0; i < kills; ++i) {
      // Two of three meet a client at work, the third its return.
      const int from = chunks, after = 1 + moments.UniformInt(6);
      for (int ms = 0; i % 3 != 0 && ms < 20000 && chunks < from + after; ++ms)
        std::this_thread::sleep_for(std::chrono::milliseconds(1));
      std::this_thread::sleep_for(
          std::chrono::microseconds(static_cast<int64_t>(moments.Uniform(0, 6e4))));
      forge->Kill();
      if (forge->Start(folder.string(), port) != port) break;
    }
    done = true;
  });
  ToyArm arm(0.6);
  absl::Status status;
  while (status.ok() && (!done || chunks < 60)) {
    status = RunChunk(
        arm, chunks,
        [&](int task, int episode) {
          return (*client)->StartEpisode({task, episode});
        },
        [&](const Observation& observation, int, int, int chunk) {
          return (*client)->Predict(observation, chunk);
        },
        [&](const ExecutedChunk& executed) { return (*client)->SendFeedback(executed); });
    ++chunks;
  }
  killer.join();
  ASSERT_TRUE(status.ok()) << status << " in chunk " << chunks;
  const auto learned = (*client)->ExportAdapter();
  ASSERT_TRUE(learned.ok()) << learned.status();

  Rig rig;
  const auto session = rig.Open(LearningSession());
  ToyArm twin(0.6);
  for (int i = 0; i < chunks; ++i) {
    const auto sequence = static_cast<uint64_t>(i);
    const absl::Status ran = RunChunk(
        twin, i,
        [&](int task, int episode) {
          return session->StartEpisode({task, episode}, sequence);
        },
        [&](const Observation& observation, int task, int episode, int chunk) {
          return session->Predict(Shared(observation), {{task, episode}, chunk}, sequence);
        },
        [&](const ExecutedChunk& executed) { return session->Feedback(executed).status(); });
    ASSERT_TRUE(ran.ok()) << ran;
  }
  EXPECT_EQ(learned->feedback_sequence, static_cast<uint64_t>(chunks));
  EXPECT_GT(learned->updates_applied, 20u);
  EXPECT_TRUE(learned->safetensors == ExportOf(*session))
      << "LoRA, Adam, buffer or counters differ in a bit";
  std::printf("%d kills, resumed %d times, %d chunks, %d updates: %zu bytes of state are equal\n",
              kills, static_cast<int>((*client)->resumes()), chunks.load(),
              static_cast<int>(learned->updates_applied), learned->safetensors.size());
  client->reset();
  forge->Kill();
  fs::remove_all(folder);
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  static robostress::ServerForge forge;  // before any thread
  robostress::forge = &forge;
  ::testing::InitGoogleTest(&argc, argv);
  return RUN_ALL_TESTS();
}
