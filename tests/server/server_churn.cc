// Clients that come and go, well-behaved and not, for as long as wanted; prints once a minute what
// the server holds. Memory, threads and descriptors must not grow.
//   server_churn build/release/bin/robostress-serve --minutes 60
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <memory>

#include "common/command_line.h"
#include "common/random.h"
#include "common/rpc/policy_client.h"
#include "common/run_main.h"
#include "server/sessions/read_spec.h"
#include "tests/adapter/toy_arm.h"
#include "tests/common/wire/openpi_bytes.h"
#include "tests/server/serve_process.h"
#include "tests/server/serving_load.h"
#include "tests/server/wire/web_client.h"

namespace robostress {
namespace {

using Clock = std::chrono::steady_clock;

struct Counts {
  std::atomic<int> sessions{0}, chunks{0}, resumed{0}, abandoned{0}, refused{0}, sockets{0},
      errors{0};
};

// One session's life: some chunks with feedback, some of it malformed; then it is closed, left for
// another client that resumes it, or left for good.
absl::Status LiveOnce(const PolicyClientOptions& options, const PolicySpec& policy,
                      RandomStream& random, Counts& counts) {
  SessionSpec spec;
  spec.suite = "tabletop_goal";
  spec.scenario = "heavy_payload";
  spec.policy = policy.name;
  spec.seed = random.UniformInt(1000);
  spec.mode = random.UniformInt(2) == 0 ? ExecutionMode::kLockstep : ExecutionMode::kAsync;
  spec.method = *MakeMethod(random.UniformInt(4) == 0 ? "base" : "ours",
                            {"buffer_chunks=4", "update_interval=2", "batch=4"});
  auto client = GrpcPolicyClient::Connect(options, RequestOf(spec));
  if (!client.ok()) return client.status();
  ++counts.sessions;
  ToyArm arm(0.6);
  int chunk = 0;
  const auto run = [&](int chunks) -> absl::Status {
    if (absl::Status status = (*client)->StartEpisode({0, chunk}); !status.ok()) return status;
    for (int i = 0; i < chunks; ++i) {
      Observation observation = BlankObservation(policy);
      if (random.UniformInt(20) == 0) {
        observation.proprioception[0] = std::nanf("");
        counts.refused += !(*client)->Predict(observation, i).ok();
        return absl::OkStatus();
      }
      const auto prediction = (*client)->Predict(observation, i);
      if (!prediction.ok()) return prediction.status();
      ExecutedChunk executed = arm.Execute(*prediction, 5);
      executed.sequence = (*client)->last_feedback_sequence() + 1;
      executed.episode = chunk;
      executed.chunk = i;
      if (absl::Status status = (*client)->SendFeedback(executed); !status.ok()) return status;
      ++counts.chunks;
    }
    return absl::OkStatus();
  };
  if (absl::Status status = run(1 + random.UniformInt(10)); !status.ok()) return status;
  const int fate = random.UniformInt(4);
  if (fate >= 2) return absl::OkStatus();
  const SessionTicket ticket = (*client)->Leave();
  client->reset();
  if (fate == 1) return ++counts.abandoned, absl::OkStatus();
  client = GrpcPolicyClient::Resume(options, ticket, spec.mode);
  if (!client.ok()) return client.status();
  ++counts.resumed;
  chunk = 1;
  return run(2);
}

// A WebSocket client that observes, or sends nonsense, or is cut in the middle.
void TouchWebSocket(int port, RandomStream& random, Counts& counts) {
  WebClient client(port);
  if (client.Upgrade() != 101) return;
  ++counts.sockets;
  client.Read();
  OpenpiBytes message;
  message.Map(4);
  for (const char* key : {"observation/image", "observation/wrist_image"})
    message.Text(key).Array("|u1", {64, 64, 3}, std::string(64 * 64 * 3, 'p'));
  message.Text("observation/state").Numbers<double>("<f8", {8}, std::vector<double>(8, 0.5));
  message.Text("prompt").Text("put the bowl on the plate");
  const std::string frame = WebClient::FrameBytes(message.bytes());
  switch (random.UniformInt(3)) {
    case 0:
      client.Send(frame.substr(0, static_cast<size_t>(random.UniformInt(20000))));
      break;
    case 1:
      client.SendFrame("nonsense");
      client.Read();
      break;
    default:
      client.Send(frame);
      client.Read();
  }
}

struct Held {
  double mib = 0;
  int threads = 0, descriptors = 0;
};

Held HeldBy(pid_t pid) {
  const std::string folder = absl::StrCat("/proc/", pid);
  Held held;
  std::ifstream status(folder + "/status");
  for (std::string key; status >> key; status.ignore(1000, '\n')) {
    if (key == "VmRSS:") status >> held.mib;
    if (key == "Threads:") status >> held.threads;
  }
  held.mib /= 1024;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(folder + "/fd"))
    ++held.descriptors;
  return held;
}

// Of the server's sessions; removed at the end.
struct StateFolder {
  const std::filesystem::path path =
      std::filesystem::temp_directory_path() / absl::StrCat("server_churn-", getpid());
  ~StateFolder() { std::filesystem::remove_all(path); }
};

int Run(const std::string& program, double minutes, int clients, double pause_s) {
  const StateFolder state;  // outlives the server
  ServeProcess server(
      program, {"--websocket-listen", "127.0.0.1:0", "--max-sessions", "64",
                "--min-update-interval", "1", "--session-expiry", "30", "--snapshot-records", "64",
                "--log-level", "error", "--state-dir", state.path.string()});
  PolicyClientOptions options;
  options.address = server.Address("grpc");
  const auto info = GetServerInfo(options);
  if (!info.ok()) return std::fprintf(stderr, "%s\n", info.status().ToString().c_str()), 1;
  Counts counts;
  std::atomic<bool> done{false};
  std::vector<std::thread> threads;
  for (int i = 0; i < clients; ++i) {
    threads.emplace_back([&, i] {
      RandomStream random(StreamKey("churn").With(int64_t{i}));
      while (!done) {
        if (random.UniformInt(3) == 0) TouchWebSocket(server.port("websocket"), random, counts);
        const absl::Status status = LiveOnce(options, info->policies[0], random, counts);
        if (!status.ok() && ++counts.errors <= 20)
          std::fprintf(stderr, "%s\n", status.ToString().c_str());
        std::this_thread::sleep_for(std::chrono::duration<double>(random.Uniform(0, 2 * pause_s)));
      }
    });
  }
  std::printf("%7s %9s %8s %8s %10s %8s %8s %7s %9s %8s %6s\n", "minute", "sessions", "chunks",
              "resumed", "abandoned", "refused", "sockets", "errors", "RSS [MiB]", "threads",
              "fds");
  const Clock::time_point begin = Clock::now();
  std::vector<double> mib;
  for (int minute = 1; minute <= minutes; ++minute) {
    std::this_thread::sleep_until(begin + std::chrono::minutes(minute));
    const Held held = HeldBy(server.pid());
    mib.push_back(held.mib);
    std::printf("%7d %9d %8d %8d %10d %8d %8d %7d %9.1f %8d %6d\n", minute, counts.sessions.load(),
                counts.chunks.load(), counts.resumed.load(), counts.abandoned.load(),
                counts.refused.load(), counts.sockets.load(), counts.errors.load(), held.mib,
                held.threads, held.descriptors);
    std::fflush(stdout);
  }
  done = true;
  for (std::thread& thread : threads) thread.join();
  if (mib.size() >= 4) {
    const auto quarter = static_cast<std::ptrdiff_t>(mib.size() / 4);
    const double second = *std::max_element(mib.begin() + quarter, mib.begin() + 2 * quarter),
                 last = *std::max_element(mib.end() - quarter, mib.end());
    std::printf("largest in the second quarter %.1f MiB, in the last %.1f MiB: %+.1f %%\n", second,
                last, 100 * (last / second - 1));
  }
  return counts.errors == 0 ? 0 : 1;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app("Churns sessions of a policy server and prints what the server holds.",
                           "server_churn");
  std::string program;
  double minutes = 60, pause_s = 0.5;
  int clients = 4;
  app.add_option("PROGRAM", program, "robostress-serve")
      ->required()
      ->check(robostress::cli::ExistingFile());
  app.add_option("--minutes", minutes)->capture_default_str();
  app.add_option("--clients", clients, "at a time")->capture_default_str();
  app.add_option("--pause", pause_s, "mean rest of a client between two sessions [s]")
      ->capture_default_str();
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  return robostress::Run(program, minutes, clients, pause_s);
}
