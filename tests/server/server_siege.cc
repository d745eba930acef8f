// A robot that behaves well beside clients that do not, for as long as wanted: first alone, then
// under every attack in turn and all at once. Prints the robot's latencies and errors, what each
// attack got, and what the server holds. The attackers' threads run at the lowest priority: they
// stand for other machines, whose processors are not the server's.
//   server_siege build/release/bin/robostress-serve --minutes 60
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <cstdio>
#include <fstream>
#include <functional>
#include <memory>
#include <thread>

#include "absl/strings/match.h"
#include "common/atomic_file.h"
#include "common/command_line.h"
#include "common/random.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_sessions.h"
#include "common/rpc/convert_specs.h"
#include "common/rpc/grpc_status.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/sessions/read_spec.h"
#include "tests/adapter/toy_arm.h"
#include "tests/common/wire/openpi_bytes.h"
#include "tests/server/serve_process.h"
#include "tests/server/serving_load.h"
#include "tests/server/wire/raw_call.h"
#include "tests/server/wire/web_client.h"

namespace robostress {
namespace {

using Clock = std::chrono::steady_clock;

std::shared_ptr<grpc::Channel> Connect(const std::string& address) {
  grpc::ChannelArguments arguments;
  arguments.SetInt(GRPC_ARG_USE_LOCAL_SUBCHANNEL_POOL, 1);  // a connection of its own
  arguments.SetMaxSendMessageSize(-1);
  return grpc::CreateCustomChannel(address, grpc::InsecureChannelCredentials(), arguments);
}

// A session over gRPC with a token; five of each chunk's steps are executed and reported.
class Robot {
 public:
  Robot(const std::string& address, std::string token, std::vector<std::string> overrides)
      : channel_(Connect(address)),
        stub_(v1::PolicyService::NewStub(channel_)),
        token_(std::move(token)),
        overrides_(std::move(overrides)) {}

  absl::Status Open(const std::string& method = "ours") {
    predict_.reset();
    feedback_.reset();
    chunk_ = 0;
    sequence_ = 0;
    v1::GetServerInfoResponse info;
    RS_RETURN_IF_ERROR(FromGrpc(stub_->GetServerInfo(Context().get(), {}, &info)));
    policy_ = *FromProto(info.policies(0));
    SessionSpec spec;
    spec.suite = spec.scenario = "siege";
    spec.policy = policy_.name;
    spec.mode = ExecutionMode::kAsync;
    spec.method = *MakeMethod(method, overrides_);
    v1::OpenSessionRequest request;
    *request.mutable_spec() = ToProto(RequestOf(spec));
    RS_RETURN_IF_ERROR(FromGrpc(stub_->OpenSession(Context().get(), request, &session_)));
    v1::StartEpisodeRequest start;
    start.set_session_id(session_.session_id());
    v1::StartEpisodeResponse started;
    RS_RETURN_IF_ERROR(FromGrpc(stub_->StartEpisode(Context().get(), start, &started)));
    predict_context_ = Context();
    predict_ = stub_->Predict(predict_context_.get());
    feedback_context_ = Context();
    feedback_ = stub_->Feedback(feedback_context_.get());
    return absl::OkStatus();
  }
  // One chunk there and back; the time to the prediction [ms].
  absl::StatusOr<double> Step() {
    if (predict_ == nullptr) return absl::UnavailableError("no session is open");
    v1::PredictRequest request;
    request.set_session_id(session_.session_id());
    request.set_chunk(static_cast<uint32_t>(chunk_));
    *request.mutable_observation() = ToProto(BlankObservation(policy_));
    const Clock::time_point begin = Clock::now();
    v1::PredictResponse response;
    if (!predict_->Write(request) || !predict_->Read(&response)) return Ended("Predict", predict_);
    const double ms = std::chrono::duration<double, std::milli>(Clock::now() - begin).count();
    if (response.has_refusal()) return ToStatus(response.refusal());
    ExecutedChunk executed = arm_.Execute(*FromProto(response), 5);
    executed.sequence = ++sequence_;
    executed.chunk = chunk_++;
    v1::FeedbackRequest feedback;
    feedback.set_session_id(session_.session_id());
    *feedback.mutable_chunk() = ToProto(executed);
    v1::FeedbackAck ack;
    if (!feedback_->Write(feedback) || !feedback_->Read(&ack)) return Ended("Feedback", feedback_);
    if (ack.sequence() != sequence_) return absl::DataLossError("an acknowledgement is missing");
    return ms;
  }
  std::string Export() {
    v1::ExportAdapterRequest request;
    request.set_session_id(session_.session_id());
    v1::ExportAdapterResponse response;
    return stub_->ExportAdapter(Context().get(), request, &response).ok() ? response.safetensors()
                                                                          : "";
  }
  const std::string& id() const { return session_.session_id(); }
  const std::shared_ptr<grpc::Channel>& channel() const { return channel_; }

 private:
  // A stream can be finished once.
  template <class Stream>
  absl::Status Ended(const char* what, Stream& stream) {
    const std::string why = stream->Finish().error_message();
    predict_.reset();
    feedback_.reset();
    return absl::UnavailableError(absl::StrCat(what, ": ", why));
  }
  std::unique_ptr<grpc::ClientContext> Context() const {
    auto context = std::make_unique<grpc::ClientContext>();
    context->AddMetadata("authorization", "Bearer " + token_);
    return context;
  }

  const std::shared_ptr<grpc::Channel> channel_;
  const std::unique_ptr<v1::PolicyService::Stub> stub_;
  const std::string token_;
  const std::vector<std::string> overrides_;
  PolicySpec policy_;
  v1::OpenSessionResponse session_;
  ToyArm arm_{0.6};
  int chunk_ = 0;
  uint64_t sequence_ = 0;
  std::unique_ptr<grpc::ClientContext> predict_context_, feedback_context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::PredictRequest, v1::PredictResponse>> predict_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::FeedbackRequest, v1::FeedbackAck>> feedback_;
};
struct Target {
  const ServeProcess& server;
  std::string robot_session;  // somebody else's
  std::atomic<bool>& stop;
  std::atomic<uint64_t>& tried;
  std::atomic<uint64_t>& let_in;

  std::string address() const { return server.Address("grpc"); }
  // Whether the attack still goes on after `seconds`.
  bool Rest(double seconds) const {
    const auto until = Clock::now() + std::chrono::duration<double>(seconds);
    while (!stop && Clock::now() < until)
      std::this_thread::sleep_for(std::chrono::milliseconds(20));
    return !stop;
  }
};

constexpr char kService[] = "/robostress.v1.PolicyService/";

// 200 streams on which nothing is ever said, some after one message.
void SilentStreams(const Target& target) {
  const auto channel = Connect(target.address());
  std::vector<std::unique_ptr<RawCall>> calls;
  v1::PredictRequest request;
  request.set_session_id(target.robot_session);
  for (int i = 0; i < 200 && !target.stop; ++i, ++target.tried) {
    calls.push_back(std::make_unique<RawCall>(
        channel, absl::StrCat(kService, i % 2 == 0 ? "Predict" : "Feedback"), "attacker"));
    if (i % 5 == 0) calls.back()->Write(request.SerializeAsString());
  }
  while (target.Rest(1)) {
  }
}

// Lockstep predictions that wait for feedback that never comes, on many streams.
void WaitingPredictions(const Target& target) {
  const auto channel = Connect(target.address());
  const auto stub = v1::PolicyService::NewStub(channel);
  const auto context = [] {
    auto made = std::make_unique<grpc::ClientContext>();
    made->AddMetadata("authorization", "Bearer attacker");
    return made;
  };
  v1::OpenSessionRequest open;
  SessionSpec spec;
  spec.suite = spec.scenario = "siege";
  spec.policy = "nano:random";
  spec.method = *MakeMethod("ours", {});
  v1::GetServerInfoResponse info;
  if (!stub->GetServerInfo(context().get(), {}, &info).ok()) return;
  spec.policy = info.policies(0).name();
  *open.mutable_spec() = ToProto(RequestOf(spec));
  v1::OpenSessionResponse session;
  while (!stub->OpenSession(context().get(), open, &session).ok())
    if (!target.Rest(1)) return;
  v1::StartEpisodeRequest start;
  start.set_session_id(session.session_id());
  v1::StartEpisodeResponse started;
  stub->StartEpisode(context().get(), start, &started);
  v1::PredictRequest request;
  request.set_session_id(session.session_id());
  request.set_last_feedback_sequence(1000000);
  *request.mutable_observation() = ToProto(BlankObservation(*FromProto(info.policies(0))));
  std::vector<std::unique_ptr<RawCall>> calls;
  for (int i = 0; i < 200 && !target.stop; ++i, ++target.tried) {
    calls.push_back(
        std::make_unique<RawCall>(channel, absl::StrCat(kService, "Predict"), "attacker"));
    calls.back()->Write(request.SerializeAsString());
  }
  while (target.Rest(1)) {
  }
}

// Eight calls at a time of 250 MiB, with a token or without one.
void HugeMessages(const Target& target, const std::string& token) {
  const grpc::Slice bytes(std::string(size_t{250} << 20, 'x'));
  do {
    std::vector<std::thread> threads;
    for (int i = 0; i < 8; ++i) {
      threads.emplace_back([&, i] {
        const auto channel = Connect(target.address());
        RawCall call(channel, absl::StrCat(kService, i % 2 == 0 ? "ImportAdapter" : "Predict"),
                     token);
        call.Write(bytes);
        ++target.tried;
        target.let_in += call.Finish().ok();
      });
    }
    for (std::thread& thread : threads) thread.join();
  } while (target.Rest(5));
}

// Bytes that are no message, and messages with one field out of order, on every method.
void Damaged(const Target& target) {
  RandomStream random(StreamKey("damaged"));
  const auto channel = Connect(target.address());
  v1::PredictRequest valid;
  valid.set_session_id(target.robot_session);
  const std::string good = valid.SerializeAsString();
  while (!target.stop) {
    std::string bytes = good;
    for (int i = random.UniformInt(8); i >= 0; --i)
      bytes.insert(bytes.begin() + random.UniformInt(static_cast<int>(bytes.size()) + 1),
                   static_cast<char>(random.UniformInt(256)));
    const char* methods[] = {"Predict",      "Feedback",      "OpenSession", "ImportAdapter",
                             "StartEpisode", "ResumeSession", "GetStats",    "RollbackAdapter"};
    RawCall call(channel, absl::StrCat(kService, methods[random.UniformInt(8)]), "attacker");
    call.Write(bytes);
    call.WritesDone();
    ++target.tried;
    target.let_in += call.Finish().ok();
    if (target.tried % 50 == 0 && !target.Rest(0.2)) return;
  }
}

// Another's session, by its id.
void ForeignSession(const Target& target) {
  const auto channel = Connect(target.address());
  v1::CloseSessionRequest request;
  request.set_session_id(target.robot_session);
  do {
    for (const char* method :
         {"CloseSession", "Predict", "Feedback", "ExportAdapter", "ImportAdapter",
          "RollbackAdapter", "GetStats", "StartEpisode", "ResumeSession"}) {
      RawCall call(channel, absl::StrCat(kService, method), "attacker");
      call.Write(request.SerializeAsString());
      call.WritesDone();
      ++target.tried;
      target.let_in += call.Finish().ok();
    }
  } while (target.Rest(0.5));
}

OpenpiBytes OpenpiObservation(int side, bool names_session) {
  OpenpiBytes message;
  message.Map(names_session ? 5 : 4);
  if (names_session) {
    message.Text("session").Map(1);
    message.Text("method").Text("ours");
  }
  for (const char* key : {"observation/image", "observation/wrist_image"})
    message.Text(key).Array("|u1", {side, side, 3},
                            std::string(static_cast<size_t>(3 * side * side), 'p'));
  message.Text("observation/state").Numbers<double>("<f8", {8}, std::vector<double>(8, 0.5));
  message.Text("prompt").Text("put the bowl on the plate");
  return message;
}

constexpr char kAttacker[] = "Authorization: Api-Key attacker\r\n";

// WebSocket clients that name a session and leave.
void NameAndLeave(const Target& target) {
  const std::string frame = WebClient::FrameBytes(OpenpiObservation(64, true).bytes());
  while (!target.stop) {
    for (int i = 0; i < 64 && !target.stop; ++i) {
      WebClient client(target.server.port("websocket"), 5);
      ++target.tried;
      if (client.Upgrade(kAttacker) != 101) continue;
      client.Read();
      client.Send(frame);
      target.let_in += client.Read().opcode == WebClient::kBinary;
    }
    if (!target.Rest(2)) return;
  }
}

// 63 MiB where eight numbers belong.
void HugeArray(const Target& target) {
  const auto n = (int64_t{63} << 20) / 8;
  OpenpiBytes message;
  message.Map(2);
  message.Text("observation/state")
      .Array("<f8", {n}, std::string(static_cast<size_t>(8 * n), '\0'));
  message.Text("prompt").Text("x");
  const std::string frame = WebClient::FrameBytes(message.bytes());
  do {
    WebClient client(target.server.port("websocket"), 20);
    ++target.tried;
    if (client.Upgrade(kAttacker) != 101) continue;
    client.Read();
    client.Send(frame);
    target.let_in += client.Read().opcode == WebClient::kBinary;
  } while (target.Rest(5));
}

// Connections that say nothing, hold on, or read nothing.
void IdleConnections(const Target& target) {
  std::vector<std::unique_ptr<WebClient>> clients;
  while (!target.stop) {
    while (clients.size() < 300 && !target.stop) {
      clients.push_back(std::make_unique<WebClient>(target.server.port("websocket"), 1));
      ++target.tried;
      if (clients.size() % 3 == 0) clients.back()->Send("GET / HT");
      if (clients.size() % 3 == 1)
        clients.back()->Send("GET /x HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\n");
    }
    if (!target.Rest(20)) return;
    clients.clear();
  }
}

// Eight sessions at the robot's rate that learn with these options.
void Neighbours(const Target& target, const std::vector<std::string>& overrides) {
  std::vector<std::thread> threads;
  for (int i = 0; i < 8; ++i) {
    threads.emplace_back([&] {
      while (!target.stop) {
        Robot robot(target.address(), "attacker", overrides);
        if (!robot.Open().ok()) {
          if (!target.Rest(1)) return;
          continue;
        }
        while (!target.stop) {
          ++target.tried;
          if (!robot.Step().ok()) break;
          ++target.let_in;
          target.Rest(0.25);
        }
        target.Rest(0.5);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

// An exported adapter with its text or its bytes changed, imported.
void ImportMutants(const Target& target) {
  RandomStream random(StreamKey("mutants"));
  while (!target.stop) {
    Robot robot(target.address(), "attacker", {"buffer_chunks=8", "update_interval=8", "batch=4"});
    if (!robot.Open().ok()) {
      if (!target.Rest(1)) return;
      continue;
    }
    for (int i = 0; i < 9; ++i)
      if (!robot.Step().ok()) break;
    const std::string good = robot.Export();
    for (int i = 0; i < 40 && !good.empty() && !target.stop; ++i) {
      v1::ImportAdapterRequest request;
      request.set_session_id(robot.id());
      std::string bytes = good;
      const size_t header = std::min<size_t>(bytes.size(), 20000);
      for (int n = random.UniformInt(3); n >= 0; --n) {  // digits stay digits: valid, and wrong
        size_t at = static_cast<size_t>(random.UniformInt(static_cast<int>(header)));
        while (at < header && (bytes[at] < '0' || bytes[at] > '9')) ++at;
        if (at < header) bytes[at] = static_cast<char>('0' + random.UniformInt(10));
      }
      request.set_safetensors(bytes);
      RawCall call(robot.channel(), absl::StrCat(kService, "ImportAdapter"), "attacker");
      call.Write(request.SerializeAsString());
      call.WritesDone();
      ++target.tried;
      target.let_in += call.Finish().ok();
      robot.Step().IgnoreError();
    }
    if (!target.Rest(1)) return;
  }
}

struct Attack {
  const char* name;
  std::function<void(const Target&)> run;
  std::atomic<uint64_t> tried{0}, let_in{0};
  Attack(const char* n, std::function<void(const Target&)> r) : name(n), run(std::move(r)) {}
};

double OfStatus(pid_t pid, const std::string& key) {
  std::ifstream status(absl::StrCat("/proc/", pid, "/status"));
  double value = 0;
  for (std::string word; status >> word; status.ignore(1000, '\n'))
    if (word == key) status >> value;
  return value;
}

struct RobotResult {
  Latencies latencies;
  uint64_t errors = 0;
  std::string first_error;
};

// The robot for so long, at 4 Hz.
RobotResult Drive(Robot& robot, double seconds) {
  RobotResult result;
  const Clock::time_point begin = Clock::now();
  const auto end = begin + std::chrono::duration<double>(seconds);
  for (int i = 0; i == 0 || Clock::now() < end; ++i) {
    std::this_thread::sleep_until(begin + i * std::chrono::milliseconds(250));
    const absl::StatusOr<double> ms = robot.Step();
    if (ms.ok()) {
      result.latencies.ms.push_back(*ms);
      continue;
    }
    if (result.errors++ == 0) result.first_error = ms.status().ToString();
    if (absl::IsUnavailable(ms.status())) robot.Open().IgnoreError();
  }
  return result;
}

int Run(const std::string& program, double minutes, const std::string& only, bool together,
        const std::vector<std::string>& extra) {
  const auto folder = std::filesystem::temp_directory_path() / absl::StrCat("siege-", getpid());
  std::filesystem::create_directories(folder);
  std::string tokens = "tokens:\n";
  for (const char* name : {"robot", "attacker"})
    absl::StrAppend(&tokens, "  - {name: ", name, ", sha256: ", Sha256Hex(name),
                    ", scopes: [predict, feedback]}\n");
  const std::string file = (folder / "tokens.yaml").string();
  if (!WriteFileAtomically(file, tokens).ok()) return 1;
  std::vector<std::string> arguments = {
      "--websocket-listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0",
      "--tokens",           file,          "--state-dir",   (folder / "state").string(),
      "--max-sessions",     "64",          "--log-level",   "off"};
  arguments.insert(arguments.end(), extra.begin(), extra.end());
  Attack attacks[] = {
      {"silent streams", SilentStreams},
      {"waiting predictions", WaitingPredictions},
      {"8 x 250 MiB, no token", [](const Target& t) { HugeMessages(t, ""); }},
      {"8 x 250 MiB, a token", [](const Target& t) { HugeMessages(t, "attacker"); }},
      {"damaged messages", Damaged},
      {"another's session", ForeignSession},
      {"name and leave", NameAndLeave},
      {"63 MiB array", HugeArray},
      {"idle connections", IdleConnections},
      {"8 x the paper's cost", [](const Target& t) { Neighbours(t, {}); }},
      {"8 x the greatest cost",
       [](const Target& t) {
         Neighbours(t, {"rank=16", "batch=8", "update_interval=4", "buffer_chunks=8"});
       }},
      {"mutated imports", ImportMutants}};
  int exit_code = 0;
  {
    ServeProcess server(program, arguments);
    Robot robot(server.Address("grpc"), "robot", {});
    if (const absl::Status status = robot.Open(); !status.ok())
      return std::fprintf(stderr, "%s\n", status.ToString().c_str()), 1;
    std::printf("%-24s %7s %8s %8s %8s %7s %9s %9s %8s %6s\n", "under", "steps", "p50 [ms]",
                "p99 [ms]", "max [ms]", "errors", "RSS [MiB]", "peak", "threads", "fds");
    const auto report = [&](const char* what, const RobotResult& result) {
      int descriptors = 0;
      for ([[maybe_unused]] const auto& entry :
           std::filesystem::directory_iterator(absl::StrCat("/proc/", server.pid(), "/fd")))
        ++descriptors;
      std::printf("%-24s %7zu %8.1f %8.1f %8.1f %7lu %9.1f %9.1f %8.0f %6d  %s\n", what,
                  result.latencies.ms.size(), result.latencies.Quantile(0.5),
                  result.latencies.Quantile(0.99), result.latencies.Quantile(1), result.errors,
                  OfStatus(server.pid(), "VmRSS:") / 1024, OfStatus(server.pid(), "VmHWM:") / 1024,
                  OfStatus(server.pid(), "Threads:"), descriptors, result.first_error.c_str());
      std::fflush(stdout);
      exit_code |= result.errors > 0;
    };
    // A third of the time alone and under each attack, the rest under all of them.
    const double alone = 60 * minutes / 3 / (1 + std::size(attacks));
    const auto attack = [&](const char* what, const std::vector<Attack*>& chosen, double seconds) {
      std::atomic<bool> stop{false};
      std::vector<std::thread> threads;
      for (Attack* one : chosen) {
        threads.emplace_back([&, one] {
          // Of this thread and those that it starts.
          setpriority(PRIO_PROCESS, static_cast<id_t>(gettid()), 19);
          one->run({server, robot.id(), stop, one->tried, one->let_in});
        });
      }
      report(what, Drive(robot, seconds));
      stop = true;
      for (std::thread& thread : threads) thread.join();
    };
    attack("nothing", {}, alone);
    std::vector<Attack*> all;
    for (Attack& one : attacks)
      if (only.empty() || absl::StrContains(one.name, only)) all.push_back(&one);
    if (all.size() > 1 && !together)
      for (Attack* one : all) attack(one->name, {one}, alone);
    const double rest = together ? minutes : minutes * 2 / 3;
    const int rounds = std::max(1, static_cast<int>(rest / 5));
    for (int i = 0; i < rounds; ++i)
      attack(all.size() == 1 ? all[0]->name : "all of them", all, 60 * rest / rounds);
    attack("nothing", {}, alone);
    std::printf("\n%-24s %12s %12s\n", "attack", "tried", "let in");
    for (const Attack& one : attacks)
      std::printf("%-24s %12lu %12lu\n", one.name, one.tried.load(), one.let_in.load());
    std::printf("%s\n", MachineNow().c_str());
  }
  std::filesystem::remove_all(folder);
  return exit_code;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app("A robot beside hostile clients of one server.", "server_siege");
  std::string program;
  double minutes = 60;
  std::string only;
  bool together = false;
  std::vector<std::string> extra;
  app.add_option("PROGRAM", program, "robostress-serve")
      ->required()
      ->check(robostress::cli::ExistingFile());
  app.add_option("--minutes", minutes)->capture_default_str();
  app.add_option("--only", only, "attacks whose name contains this");
  app.add_flag("--together", together, "all of them for the whole time, none alone");
  app.add_option("--serve", extra, "further options of the server, as one argument each");
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  return robostress::Run(program, minutes, only, together, extra);
}
