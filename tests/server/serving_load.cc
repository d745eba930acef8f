#include "tests/server/serving_load.h"

#include <sys/resource.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <fstream>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/statistics.h"
#include "common/status_macros.h"
#include "server/sessions/read_spec.h"
#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

using SteadyClock = std::chrono::steady_clock;

double CpuSeconds() {
  rusage usage{};
  getrusage(RUSAGE_SELF, &usage);
  const auto seconds = [](const timeval& t) {
    return static_cast<double>(t.tv_sec) + 1e-6 * static_cast<double>(t.tv_usec);
  };
  return seconds(usage.ru_utime) + seconds(usage.ru_stime);
}

}  // namespace

Observation BlankObservation(const PolicySpec& spec) {
  Observation observation;
  observation.instruction = "put the bowl on the plate";
  for (const std::string& camera : spec.cameras) {
    Image image{spec.image_width, spec.image_height, {}};
    image.data.resize(size_t{3} * image.width * image.height, 127);
    observation.views.push_back({camera, image});
  }
  observation.proprioception = Eigen::VectorXf::Zero(spec.state_dim);
  return observation;
}

double Latencies::Quantile(double q) const {
  if (ms.empty()) return 0;
  std::vector<double> sorted = ms;
  std::sort(sorted.begin(), sorted.end());
  return robostress::Quantile(sorted, q);
}

struct Clients::Client {
  std::unique_ptr<GrpcPolicyClient> endpoint;
  Observation observation;
  ToyArm arm{0.6};
  int chunk = 0;
  Latencies latencies;
  absl::Status status;

  absl::Status Step(bool feedback) {
    const auto begin = SteadyClock::now();
    RS_ASSIGN_OR_RETURN(const PredictedChunk prediction, endpoint->Predict(observation, chunk));
    latencies.ms.push_back(
        std::chrono::duration<double, std::milli>(SteadyClock::now() - begin).count());
    if (feedback) {
      ExecutedChunk executed = arm.Execute(prediction, 5);
      executed.sequence = endpoint->last_feedback_sequence() + 1;
      executed.chunk = chunk;
      RS_RETURN_IF_ERROR(endpoint->SendFeedback(std::move(executed)));
    }
    ++chunk;
    return absl::OkStatus();
  }

  void Run(const LoadOptions& options, SteadyClock::time_point begin, double phase) {
    latencies.ms.clear();
    const auto at = [begin](double seconds) {
      return begin + std::chrono::duration_cast<SteadyClock::duration>(
                         std::chrono::duration<double>(seconds));
    };
    for (int i = 0; status.ok(); ++i) {
      if (options.rate_hz > 0) {
        const double due = (i + phase) / options.rate_hz;
        if (due >= options.seconds || SteadyClock::now() >= at(options.seconds)) return;
        std::this_thread::sleep_until(at(due));
      } else if (SteadyClock::now() >= at(options.seconds)) {
        return;
      }
      status = Step(options.feedback);
    }
  }
};

absl::StatusOr<Clients> Clients::Connect(const PolicyServer& server, const std::string& policy,
                                         int count, const std::vector<std::string>& overrides) {
  Clients clients;
  for (int i = 0; i < count; ++i) {
    SessionSpec spec;
    spec.suite = "tabletop_goal";
    spec.scenario = "clean";
    spec.policy = policy;
    spec.seed = i;
    spec.mode = ExecutionMode::kAsync;
    RS_ASSIGN_OR_RETURN(spec.method, MakeMethod("ours", overrides));
    PolicyClientOptions options;
    options.address = absl::StrCat("127.0.0.1:", server.port());
    auto client = std::make_shared<Client>();
    RS_ASSIGN_OR_RETURN(client->endpoint, GrpcPolicyClient::Connect(options, RequestOf(spec)));
    RS_RETURN_IF_ERROR(client->endpoint->StartEpisode({0, 0}));
    client->observation = BlankObservation(client->endpoint->spec());
    clients.clients_.push_back(std::move(client));
  }
  return clients;
}

absl::StatusOr<uint64_t> Clients::Updates() {
  uint64_t sum = 0;
  for (const auto& client : clients_) {
    RS_ASSIGN_OR_RETURN(const SessionStats stats, client->endpoint->Stats());
    sum += stats.updates_applied;
  }
  return sum;
}

absl::Status Clients::Settle() {
  for (uint64_t before = ~uint64_t{0};;) {
    RS_ASSIGN_OR_RETURN(const uint64_t now, Updates());
    if (now == before) return absl::OkStatus();
    before = now;
    std::this_thread::sleep_for(std::chrono::milliseconds(200));
  }
}

absl::StatusOr<LoadResult> Clients::Run(const LoadOptions& options) {
  LoadResult result;
  RS_ASSIGN_OR_RETURN(const uint64_t updates_before, Updates());
  const double cpu_before = CpuSeconds();
  const auto begin = SteadyClock::now();
  std::vector<std::thread> threads;
  for (size_t i = 0; i < clients_.size(); ++i) {
    const double phase = static_cast<double>(i) / static_cast<double>(clients_.size());
    threads.emplace_back([&, i, phase] { clients_[i]->Run(options, begin, phase); });
  }
  for (std::thread& thread : threads) thread.join();
  result.seconds = std::chrono::duration<double>(SteadyClock::now() - begin).count();
  result.cpu_seconds = CpuSeconds() - cpu_before;
  for (const auto& client : clients_) {
    RS_RETURN_IF_ERROR(client->status);
    result.latencies.Append(client->latencies);
  }
  RS_ASSIGN_OR_RETURN(const uint64_t updates_after, Updates());
  result.updates = updates_after - updates_before;
  return result;
}

std::string MachineNow() {
  std::ifstream file("/proc/loadavg");
  std::string one, five, fifteen;
  file >> one >> five >> fifteen;
  return absl::StrCat(std::thread::hardware_concurrency(), " cores, load average ", one, " ", five,
                      " ", fifteen);
}

}  // namespace robostress
