// What one message costs the server's process: time, allocations, copies of pixels, and how often
// the session is looked up and a chunk is checked and measured. One observation of openpi's LIBERO
// client (two 224 x 224 views, 8 numbers, a prompt) and five executed steps, over gRPC and openpi's
// WebSocket, in memory and with a journal. The client is a process of its own.
//   message_cost [--rounds 20]
#include <grpcpp/grpcpp.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <vector>

#include "absl/strings/str_cat.h"
#include "adapter/plausible_motion.h"
#include "adapter/pseudo_target.h"
#include "adapter/residual.h"
#include "common/rollout/spec_checks.h"
#include "common/rpc/convert_chunks.h"
#include "common/rpc/convert_observations.h"
#include "common/rpc/convert_specs.h"
#include "common/wire/openpi_value.h"
#include "proto/robostress/v1/policy.grpc.pb.h"
#include "server/sessions/read_spec.h"
#include "server/web_endpoints.h"
#include "tests/common/wire/openpi_bytes.h"
#include "tests/server/sessions/drive.h"
#include "tests/server/wire/web_client.h"

namespace {

constexpr size_t kPixels = 3 * 224 * 224;  // [bytes] of one view
struct Counts {
  std::atomic<uint64_t> allocations{0}, bytes{0}, views{0};
  std::atomic<uint64_t> lookups{0}, validations{0}, residuals{0}, plausibility{0};
} counts;

void* Counted(void* memory, size_t bytes) {
  counts.allocations.fetch_add(1, std::memory_order_relaxed);
  counts.bytes.fetch_add(bytes, std::memory_order_relaxed);
  if (bytes >= kPixels) counts.views.fetch_add(bytes / kPixels, std::memory_order_relaxed);
  return memory;
}

}  // namespace

// Every allocation of the process, LibTorch's and gRPC's too.
extern "C" {
// NOLINTBEGIN(bugprone-reserved-identifier): those of glibc
void* __libc_malloc(size_t);
void* __libc_calloc(size_t, size_t);
void* __libc_realloc(void*, size_t);
void* __libc_memalign(size_t, size_t);
// NOLINTEND(bugprone-reserved-identifier)
void* malloc(size_t bytes) { return Counted(__libc_malloc(bytes), bytes); }
void* calloc(size_t n, size_t size) { return Counted(__libc_calloc(n, size), n * size); }
void* realloc(void* old, size_t bytes) { return Counted(__libc_realloc(old, bytes), bytes); }
void* aligned_alloc(size_t align, size_t bytes) {
  return Counted(__libc_memalign(align, bytes), bytes);
}
int posix_memalign(void** memory, size_t align, size_t bytes) {
  *memory = Counted(__libc_memalign(align, bytes), bytes);
  return *memory == nullptr ? ENOMEM : 0;
}
}

namespace robostress {

// The linker puts these before the functions of the same name (CMakeLists.txt: --wrap).
#define RS_STRING "RKNSt7__cxx1112basic_stringIcSt11char_traitsIcESaIcEEE"
#define RS_WRAP(result, name, symbol, counter, parameters, arguments)       \
  result Real##name parameters asm("__real_" symbol) __attribute__((weak)); \
  result Wrap##name parameters asm("__wrap_" symbol);                       \
  result Wrap##name parameters {                                            \
    ++counts.counter;                                                       \
    return Real##name arguments;                                            \
  }
RS_WRAP(absl::StatusOr<SessionRegistry::Lease>, Use,
        "_ZN10robostress15SessionRegistry3UseE" RS_STRING "RKNS_6CallerE", lookups,
        (SessionRegistry * registry, const std::string& id, const Caller& caller),
        (registry, id, caller))
RS_WRAP(absl::StatusOr<SessionScheduling>, SchedulingOf,
        "_ZN10robostress15SessionRegistry12SchedulingOfE" RS_STRING, lookups,
        (SessionRegistry * registry, const std::string& id), (registry, id))
RS_WRAP(absl::Status, Validate,
        "_ZN10robostress21ValidateExecutedChunkERKNS_13ExecutedChunkEiNS_13ResidualSpaceE",
        validations, (const ExecutedChunk& chunk, int dim, ResidualSpace space),
        (chunk, dim, space))
RS_WRAP(absl::Status, Check,
        "_ZN10robostress18CheckExecutedChunkERKNS_13ExecutedChunkERKNS_10PolicySpecE", validations,
        (const ExecutedChunk& chunk, const PolicySpec& spec), (chunk, spec))
RS_WRAP(Eigen::MatrixXd, Residual,
        "_ZN10robostress13ChunkResidualERKNS_13ExecutedChunkERKNS_15ResidualOptionsE", residuals,
        (const ExecutedChunk& chunk, const ResidualOptions& options), (chunk, options))
RS_WRAP(std::vector<bool>, Impossible, "_ZN10robostress15ImpossibleStepsERKNS_13ExecutedChunkE",
        plausibility, (const ExecutedChunk& chunk), (chunk))
#undef RS_WRAP
#undef RS_STRING

namespace {

using Clock = std::chrono::steady_clock;
constexpr int kBatch = 64;  // messages between two looks at the counters; predictions kept

// The fake policy with two cameras: what it computes takes about a tenth of a millisecond.
class SeeingPolicy : public FakePolicy {
 public:
  SeeingPolicy() : spec_(FakePolicy::spec()) {
    spec_.cameras = {"agentview", "wrist"};
    spec_.image_width = spec_.image_height = 224;
    spec_.state_dim = 8;
  }
  const PolicySpec& spec() const override { return spec_; }
  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    Observation state;
    state.instruction = observation.instruction;
    state.proprioception = observation.proprioception.head(kState);
    return FakePolicy::Encode(state);
  }

 private:
  PolicySpec spec_;
};

Observation Seen() {
  Observation observation;
  observation.instruction = "put the bowl on the plate";
  for (const char* camera : {"agentview", "wrist"}) {
    Image image{224, 224, std::vector<uint8_t>(kPixels)};
    for (size_t i = 0; i < image.data.size(); ++i) image.data[i] = static_cast<uint8_t>(i * 7 / 3);
    observation.views.push_back({camera, image});
  }
  observation.proprioception = Eigen::VectorXf::LinSpaced(8, 0, 1);
  return observation;
}

// One update, in the warm-up.
SessionSpec Adapting() { return Spec("ours", {"update_interval=1000000"}); }

// What the client's process does when it is told so. Times are of one message as it sees it [s].
class Driver {
 public:
  virtual ~Driver() = default;
  virtual double Predict() = 0;
  virtual double Report() = 0;
};

class GrpcDriver : public Driver {
 public:
  explicit GrpcDriver(int port)
      : stub_(v1::PolicyService::NewStub(grpc::CreateChannel(absl::StrCat("127.0.0.1:", port),
                                                             grpc::InsecureChannelCredentials()))) {
    v1::OpenSessionRequest open;
    *open.mutable_spec() = ToProto(RequestOf(Adapting()));
    v1::OpenSessionResponse opened;
    grpc::ClientContext context, start;
    Must(stub_->OpenSession(&context, open, &opened));
    v1::StartEpisodeRequest episode;
    episode.set_session_id(opened.session_id());
    v1::StartEpisodeResponse started;
    Must(stub_->StartEpisode(&start, episode, &started));
    request_.set_session_id(opened.session_id());
    *request_.mutable_observation() = ToProto(Seen());
    predict_ = stub_->Predict(&predict_context_);
    feedback_ = stub_->Feedback(&feedback_context_);
  }
  double Predict() override {
    request_.set_chunk(chunk_++);
    const auto begin = Clock::now();
    v1::PredictResponse response;
    if (!predict_->Write(request_) || !predict_->Read(&response)) Must(predict_->Finish());
    const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
    auto prediction = FromProto(response);
    Must(grpc::Status(grpc::INTERNAL, prediction.status().ToString()), prediction.ok());
    ExecutedChunk executed = arm_.Execute(*prediction, 5);
    executed.chunk = static_cast<int>(chunk_ - 1);
    executed_.push_back(executed);
    return seconds;
  }
  double Report() override {
    executed_.front().sequence = ++sequence_;
    v1::FeedbackRequest request;
    request.set_session_id(request_.session_id());
    *request.mutable_chunk() = ToProto(executed_.front());
    executed_.pop_front();
    const auto begin = Clock::now();
    v1::FeedbackAck ack;
    if (!feedback_->Write(request) || !feedback_->Read(&ack)) Must(feedback_->Finish());
    return std::chrono::duration<double>(Clock::now() - begin).count();
  }

 private:
  static void Must(const grpc::Status& status, bool ok = false) {
    if (!ok && !status.ok()) std::fprintf(stderr, "%s\n", status.error_message().c_str()), _exit(1);
  }
  std::unique_ptr<v1::PolicyService::Stub> stub_;
  grpc::ClientContext predict_context_, feedback_context_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::PredictRequest, v1::PredictResponse>> predict_;
  std::unique_ptr<grpc::ClientReaderWriter<v1::FeedbackRequest, v1::FeedbackAck>> feedback_;
  v1::PredictRequest request_;
  ToyArm arm_{0.6};
  std::deque<ExecutedChunk> executed_;
  uint32_t chunk_ = 0;
  uint64_t sequence_ = 0;
};

class SocketDriver : public Driver {
 public:
  explicit SocketDriver(int port) : socket_(port) {
    Must(socket_.Upgrade() == 101 && socket_.Read().opcode == WebClient::kBinary, "no upgrade");
    OpenpiBytes first;
    first.Map(5);
    first.Text("session").Map(3).Text("method").Text("ours").Text("mode").Text("lockstep");
    first.Text("method_options").Byte(0x91).Text("update_interval=1000000");
    See(first);
    Exchange(first);
    OpenpiBytes later;
    later.Map(4);
    See(later);
    frame_ = WebClient::FrameBytes(later.bytes());
    ++predicted_;
  }
  double Predict() override {
    ++predicted_;
    return Exchange(frame_);
  }
  double Report() override {
    OpenpiBytes message;
    ++sequence_;
    message.Map(1).Text("executed").Map(5).Text("sequence").Integer(sequence_);
    message.Text("prediction_id").Integer(sequence_ + 1);  // the first one opened the session
    message.Text("first_step").Integer(0);
    message.Text("q").Numbers<double>("<f8", {6, 7}, std::vector<double>(42, 0.25));
    message.Text("p_base_tool").Numbers<double>("<f8", {6, 3}, std::vector<double>(18, 0.1));
    return Exchange(message);
  }

 private:
  static void Must(bool ok, const std::string& why) {
    if (!ok) std::fprintf(stderr, "%s\n", why.c_str()), _exit(1);
  }
  static void See(OpenpiBytes& message) {
    const Observation seen = Seen();
    const auto bytes = [&](int view) {
      const auto& data = seen.views[static_cast<size_t>(view)].image.data;
      return std::string(data.begin(), data.end());
    };
    message.Text("observation/image").Array("|u1", {224, 224, 3}, bytes(0));
    message.Text("observation/wrist_image").Array("|u1", {224, 224, 3}, bytes(1));
    message.Text("observation/state").Numbers<double>("<f8", {8}, std::vector<double>(8, 0.5));
    message.Text("prompt").Text(seen.instruction);
  }
  double Exchange(const OpenpiBytes& message) {
    return Exchange(WebClient::FrameBytes(message.bytes()));
  }
  double Exchange(const std::string& frame) {
    const auto begin = Clock::now();
    socket_.Send(frame);
    const WebClient::Frame reply = socket_.Read();
    const double seconds = std::chrono::duration<double>(Clock::now() - begin).count();
    Must(reply.opcode == WebClient::kBinary, reply.payload);
    return seconds;
  }
  WebClient socket_;
  std::string frame_;
  uint64_t sequence_ = 0, predicted_ = 0;
};

// The client's process: a letter a batch ('g', 's': connect; 'p', 'r': predictions, reports), the
// median of the messages back.
void Drive(int commands, int answers) {
  std::unique_ptr<Driver> driver;
  struct {
    char what;
    int port;
  } command;
  while (read(commands, &command, sizeof command) == sizeof command) {
    std::vector<double> seconds{0};
    if (command.what == 'g') driver = std::make_unique<GrpcDriver>(command.port);
    if (command.what == 's') driver = std::make_unique<SocketDriver>(command.port);
    for (int i = 0; (command.what == 'p' || command.what == 'r') && i < kBatch; ++i)
      seconds.push_back(command.what == 'p' ? driver->Predict() : driver->Report());
    std::sort(seconds.begin(), seconds.end());
    const double median = seconds[seconds.size() / 2];
    if (write(answers, &median, sizeof median) != sizeof median) break;
  }
  _exit(0);
}

double CpuSeconds() {
  rusage usage;
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

// Medians over the batches, per message.
struct Row {
  std::vector<double> wall_us, cpu_us, allocations, bytes, views, lookups, validations, residuals,
      plausibility;
};

int Run(int rounds, int commands, int answers) {
  const auto tell = [&](char what, int port = 0) {
    struct {
      char what;
      int port;
    } command{what, port};
    double median = -1;
    if (write(commands, &command, sizeof command) != sizeof command) return -1.0;
    return read(answers, &median, sizeof median) == sizeof median ? median : -1.0;
  };
  std::printf("%-18s %-8s %8s %8s %8s %9s %7s %7s %7s %9s %7s\n", "wire", "message", "wall us",
              "cpu us", "allocs", "kB", "views", "lookups", "checks", "residuals", "masks");
  const std::string folder =
      std::filesystem::temp_directory_path() / absl::StrCat("cost-", getpid());
  for (const bool durable : {false, true}) {
    PolicyServerOptions options;
    options.caps.min_update_interval = 1;
    if (durable) options.state_dir = folder;
    auto server = PolicyServer::Start(options, {std::make_shared<SeeingPolicy>()});
    if (!server.ok()) return std::fprintf(stderr, "%s\n", server.status().ToString().c_str()), 1;
    WebEndpointsOptions web_options;
    web_options.websocket_listen = "127.0.0.1:0";
    web_options.openpi.session = Spec("base");
    auto web = WebEndpoints::Start(web_options, server->get());
    if (!web.ok()) return std::fprintf(stderr, "%s\n", web.status().ToString().c_str()), 1;
    for (const char wire : {'g', 's'}) {
      if (tell(wire, wire == 'g' ? (*server)->port() : (*web)->websocket_port()) < 0) return 1;
      Row rows[2];
      for (int round = -1; round < rounds; ++round) {  // the first is a warm-up
        for (const int report : {0, 1}) {
          const double cpu = CpuSeconds();
          for (auto* count : {&counts.allocations, &counts.bytes, &counts.views, &counts.lookups,
                              &counts.validations, &counts.residuals, &counts.plausibility})
            *count = 0;
          const double wall = tell(report == 1 ? 'r' : 'p');
          if (wall < 0) return 1;
          if (round < 0) continue;
          Row& row = rows[report];
          row.wall_us.push_back(1e6 * wall);
          row.cpu_us.push_back(1e6 * (CpuSeconds() - cpu) / kBatch);
          const auto add = [](std::vector<double>& to, uint64_t count) {
            to.push_back(static_cast<double>(count) / kBatch);
          };
          add(row.allocations, counts.allocations);
          add(row.bytes, counts.bytes);
          add(row.views, counts.views);
          add(row.lookups, counts.lookups);
          add(row.validations, counts.validations);
          add(row.residuals, counts.residuals);
          add(row.plausibility, counts.plausibility);
        }
      }
      const auto median = [](std::vector<double> values) {
        std::sort(values.begin(), values.end());
        return values[values.size() / 2];
      };
      for (const int report : {0, 1}) {
        const Row& row = rows[report];
        std::printf(
            "%-18s %-8s %8.0f %8.0f %8.0f %9.1f %7.2f %7.2f %7.2f %9.2f %7.2f\n",
            absl::StrCat(wire == 'g' ? "gRPC" : "WebSocket", durable ? ", journal" : "").c_str(),
            report == 1 ? "report" : "predict", median(row.wall_us), median(row.cpu_us),
            median(row.allocations), median(row.bytes) / 1e3, median(row.views),
            median(row.lookups), median(row.validations), median(row.residuals),
            median(row.plausibility));
      }
    }
  }
  std::error_code ignored;
  std::filesystem::remove_all(folder, ignored);
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  int commands[2], answers[2];
  if (pipe(commands) != 0 || pipe(answers) != 0) return 1;
  const pid_t client = fork();
  if (client == 0) {
    close(commands[1]);
    close(answers[0]);
    robostress::Drive(commands[0], answers[1]);
  }
  close(commands[0]);
  close(answers[1]);
  const int result = robostress::Run(argc > 2 ? std::atoi(argv[2]) : 20, commands[1], answers[0]);
  close(commands[1]);
  waitpid(client, nullptr, 0);
  return result;
}
