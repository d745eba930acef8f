// What the server costs with nano at its real size and random weights.
//
//   server_benchmark                     the tables below, in one run of some ten minutes
//   server_benchmark --benchmark_filter=REGEX   single functions on one core (Google Benchmark)
//
// The tables: predictions with and without updates; throughput with batches beside batches of one.
// What is compared alternates in slices of a few seconds, so that what else the machine does meets
// both alike.
#include <benchmark/benchmark.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <mutex>
#include <random>
#include <thread>
#include <utility>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/command_line.h"
#include "common/run_main.h"
#include "server/inference/operator_hook.h"
#include "server/inference/torch_threads.h"
#include "server/sessions/session.h"
#include "server/wire/grpc/policy_service.h"
#include "tests/adapter/fake_policy.h"
#include "tests/adapter/toy_arm.h"
#include "tests/server/serving_load.h"

namespace robostress {
namespace {

struct Bench {
  explicit Bench(const std::string& method) : adaptation(1), inference(BatcherOptions{1}) {
    UseOneTorchThread();
    policy = *LoadFlowPolicy("nano:random");
    observation = BlankObservation(policy->spec());
    SessionSpec spec;
    spec.suite = "tabletop_goal";
    spec.scenario = "clean";
    spec.policy = "nano";
    MethodOptions options = *MakeMethod(method);
    if (auto* lora = options.Find<LoraOptions>()) lora->learning_rate = 1e-6;
    spec.method = options;
    session = *Session::Create(spec, {policy, &adaptation, &inference}, 1);
    session->StartEpisode({0, 0}, 0).IgnoreError();
  }
  PredictedChunk Predict() {
    return *session->Predict(Shared(observation), {{0, 0}, chunk++}, sequence);
  }
  void Feedback(const PredictedChunk& prediction) {
    ExecutedChunk executed = ToyArm(0.6).Execute(prediction, 5);
    executed.chunk = chunk - 1;
    executed.sequence = ++sequence;
    session->Feedback(executed).IgnoreError();
  }

  AdaptationLoop adaptation;
  Batcher inference;
  std::shared_ptr<const FlowPolicy> policy;
  Observation observation;
  std::shared_ptr<Session> session;
  int chunk = 0;
  uint64_t sequence = 0;
};

void Encode(benchmark::State& state) {
  Bench bench("base");
  for ([[maybe_unused]] auto _ : state)
    benchmark::DoNotOptimize(bench.policy->Encode(bench.observation));
}
BENCHMARK(Encode)->Unit(benchmark::kMillisecond);

void PredictBase(benchmark::State& state) {
  Bench bench("base");
  for ([[maybe_unused]] auto _ : state) bench.Feedback(bench.Predict());
}
BENCHMARK(PredictBase)->Unit(benchmark::kMillisecond);

// With LoRA and, beside it, the unadapted policy's chunk on the same prefix.
void PredictAdaptedAndBase(benchmark::State& state) {
  Bench bench("ours");
  for (int i = 0; i < 32; ++i) bench.Feedback(bench.Predict());
  for ([[maybe_unused]] auto _ : state) benchmark::DoNotOptimize(bench.Predict());
}
BENCHMARK(PredictAdaptedAndBase)->Unit(benchmark::kMillisecond);

// One Adam step on four chunks with stored prefix keys and values.
void Update(benchmark::State& state) {
  UseOneTorchThread();
  Bench bench("ours");
  const auto adapter =
      *LoraAdapter::Create(bench.policy.get(), LoraOptions::At(1e-4), StreamKey("bench"));
  auto chunk = std::make_shared<TrainingChunk>();
  chunk->context = *bench.policy->Encode(bench.observation);
  chunk->target = torch::zeros({bench.policy->horizon(), bench.policy->model_action_dim()});
  uint64_t index = 0;
  for ([[maybe_unused]] auto _ : state)
    benchmark::DoNotOptimize(adapter->Update(index++, {chunk, chunk, chunk, chunk}));
}
BENCHMARK(Update)->Unit(benchmark::kMillisecond);

// Where an update can stop: operators of one, and the longest stretch between two of them.
std::chrono::steady_clock::time_point last_point;
double longest_ms = 0;
int points = 0;
void NotePoint() {
  const auto now = std::chrono::steady_clock::now();
  longest_ms =
      std::max(longest_ms, std::chrono::duration<double, std::milli>(now - last_point).count());
  last_point = now;
  ++points;
}

void UpdateWithYieldPoints(benchmark::State& state) {
  UseOneTorchThread();
  Bench bench("ours");
  const auto adapter =
      *LoraAdapter::Create(bench.policy.get(), LoraOptions::At(1e-4), StreamKey("bench"));
  auto chunk = std::make_shared<TrainingChunk>();
  chunk->context = *bench.policy->Encode(bench.observation);
  chunk->target = torch::zeros({bench.policy->horizon(), bench.policy->model_action_dim()});
  const OperatorHook hook(&NotePoint);
  std::vector<double> longest;
  uint64_t index = 0;
  for ([[maybe_unused]] auto _ : state) {
    last_point = std::chrono::steady_clock::now();
    longest_ms = 0;
    points = 0;
    benchmark::DoNotOptimize(adapter->Update(index++, {chunk, chunk, chunk, chunk}));
    longest.push_back(longest_ms);
  }
  std::sort(longest.begin(), longest.end());
  state.counters["yield_points"] = points;
  state.counters["longest_ms_median"] = longest[longest.size() / 2];
}
BENCHMARK(UpdateWithYieldPoints)->Unit(benchmark::kMillisecond);

// -------------------------------------------------------------------------------------- the tables

struct TableOptions {
  double seconds = 3;  // of a slice
  int slices = 10;     // of each kind
  int threads = 2;
  int arms = 4;
  double rate_hz = 4;       // predictions of an arm per second: five steps at 20 Hz
  int update_interval = 8;  // chunks per update: the paper's. More than the share of updates allows
                            // holds feedback up, and with it the load
  bool load = true, batches = true;
};

void OrDie(const absl::Status& status) {
  if (status.ok()) return;
  std::fprintf(stderr, "server_benchmark: %s\n", status.ToString().c_str());
  std::exit(1);
}

template <class T>
T OrDie(absl::StatusOr<T> value) {
  OrDie(value.status());
  return *std::move(value);
}

// One line of the first table: a way to serve, with two equal sets of arms; one set's chunks
// trigger updates, the other's none any more.
struct Serving {
  std::string name;
  std::unique_ptr<PolicyServer> server;
  Clients without, with;
  std::vector<LoadResult> slices_without, slices_with;
};

void Add(const LoadResult& slice, LoadResult& sum) {
  sum.latencies.Append(slice.latencies);
  sum.seconds += slice.seconds;
  sum.cpu_seconds += slice.cpu_seconds;
  sum.updates += slice.updates;
}

LoadResult Sum(const std::vector<LoadResult>& slices) {
  LoadResult sum;
  for (const LoadResult& slice : slices) Add(slice, sum);
  return sum;
}

double P99Ratio(const std::vector<LoadResult>& with, const std::vector<LoadResult>& without) {
  return Sum(with).latencies.Quantile(0.99) / Sum(without).latencies.Quantile(0.99);
}

// 95 % of the ratio of p99 over slices drawn again with replacement, in pairs of neighbours.
std::pair<double, double> P99RatioInterval(const Serving& s) {
  std::vector<double> ratios;
  std::mt19937 random(1);
  std::uniform_int_distribution<size_t> draw(0, s.slices_with.size() - 1);
  for (int i = 0; i < 1000; ++i) {
    std::vector<LoadResult> with, without;
    for (size_t k = 0; k < s.slices_with.size(); ++k) {
      const size_t slice = draw(random);
      with.push_back(s.slices_with[slice]);
      without.push_back(s.slices_without[slice]);
    }
    ratios.push_back(P99Ratio(with, without));
  }
  std::sort(ratios.begin(), ratios.end());
  return {ratios[25], ratios[974]};
}

Serving Serve(const std::string& name, PolicyServerOptions options, const TableOptions& table,
              const std::shared_ptr<const FlowPolicy>& policy) {
  options.threads = table.threads;
  options.caps.min_update_interval = 1;
  Serving serving{name, OrDie(PolicyServer::Start(options, {policy}))};
  const std::vector<std::string> common{"learning_rate=1e-6", "buffer_chunks=4", "batch=4"};
  std::vector<std::string> often = common, once = common;
  often.push_back(absl::StrCat("update_interval=", table.update_interval));
  once.push_back("update_interval=1000000");  // one, so that both sets predict with an adapter
  const std::string& policy_name = policy->spec().name;
  serving.with = OrDie(Clients::Connect(*serving.server, policy_name, table.arms, often));
  serving.without = OrDie(Clients::Connect(*serving.server, policy_name, table.arms, once));
  for (Clients* clients : {&serving.with, &serving.without}) {
    OrDie(clients->Run({6 / table.rate_hz, table.rate_hz, true}));
  }
  return serving;
}

void PrintLoad(const char* name, const char* updates, const LoadResult& r) {
  std::printf("%-28s %-8s %6zu %8.2f %8.2f %8.2f %9.1f %9.2f", name, updates, r.latencies.ms.size(),
              r.latencies.Quantile(0.5), r.latencies.Quantile(0.9), r.latencies.Quantile(0.99),
              static_cast<double>(r.updates) / r.seconds, r.cpu_seconds / r.seconds);
}

void PrintServing(const Serving& s) {
  PrintLoad(s.name.c_str(), "none", Sum(s.slices_without));
  std::printf("\n");
  PrintLoad("", "running", Sum(s.slices_with));
  const auto [low, high] = P99RatioInterval(s);
  std::printf(" %9.2f [%.2f, %.2f]\n", P99Ratio(s.slices_with, s.slices_without), low, high);
}

void PrintUpdatesTable(const TableOptions& table, const std::shared_ptr<const FlowPolicy>& policy) {
  PolicyServerOptions yielding, always, greedy;
  always.cores = 1;
  greedy.update_share = 1;
  greedy.update_nice = 0;
  std::vector<Serving> servings;
  servings.push_back(Serve("yield (default)", yielding, table, policy));
  servings.push_back(Serve("yield, --cores 1", always, table, policy));
  servings.push_back(Serve("do not yield", greedy, table, policy));
  for (const double rate : {table.rate_hz, 0.0}) {
    std::printf("\nPredictions with and without updates: %d arms, %s, %d threads; %s\n", table.arms,
                rate > 0 ? absl::StrCat(rate, " predictions/s each").c_str()
                         : "each asks as soon as it is answered",
                table.threads, MachineNow().c_str());
    std::printf("%-28s %-8s %6s %8s %8s %8s %9s %9s   %s\n", "", "updates", "n", "p50 ms", "p90 ms",
                "p99 ms", "updates/s", "cores", "p99 ratio and its 95 %");
    for (Serving& s : servings) {
      s.slices_with.clear();
      s.slices_without.clear();
    }
    for (int i = 0; i < table.slices; ++i) {
      for (Serving& s : servings) {
        s.slices_without.push_back(OrDie(s.without.Run({table.seconds, rate, true})));
        s.slices_with.push_back(OrDie(s.with.Run({table.seconds, rate, true})));
        OrDie(s.with.Settle());
      }
    }
    for (const Serving& s : servings) PrintServing(s);
    std::printf("after: %s\n", MachineNow().c_str());
  }
}

// A device that computes one pass at a time, in a time that hardly depends on the rows: 20 ms and
// 1 ms for each. It stands for an accelerator, which reads its weights once per pass.
class DevicePolicy : public FakePolicy {
 public:
  torch::Tensor Sample(const PolicyContext& context, const torch::Tensor& noise,
                       const LoraWeights*) const override {
    return Pass(context, noise);
  }
  torch::Tensor SampleRows(const PolicyContext& context, const torch::Tensor& noise,
                           const std::vector<const LoraWeights*>&) const override {
    return Pass(context, noise);
  }

 private:
  torch::Tensor Pass(const PolicyContext&, const torch::Tensor& noise) const {
    const std::lock_guard lock(device_);
    std::this_thread::sleep_for(std::chrono::milliseconds(20 + noise.size(0)));
    return noise.clamp(-1, 1);
  }
  mutable std::mutex device_;
};

void PrintBatchesTable(const TableOptions& table, const std::string& what,
                       const std::shared_ptr<const FlowPolicy>& policy) {
  std::printf("\nThroughput, %s: clients ask as soon as they are answered, %d threads; %s\n",
              what.c_str(), table.threads, MachineNow().c_str());
  std::printf("%8s | %13s %8s %8s | %13s %8s %8s | %6s\n", "clients", "batch of one/s", "p50 ms",
              "p99 ms", "batches of 8/s", "p50 ms", "p99 ms", "ratio");
  for (const int count : {1, 2, 4, 8, 16}) {
    PolicyServerOptions options;
    options.threads = table.threads;
    options.max_batch = 1;
    options.caps.min_update_interval = 1;
    const auto one = OrDie(PolicyServer::Start(options, {policy}));
    options.max_batch = 8;
    const auto batched = OrDie(PolicyServer::Start(options, {policy}));
    const std::vector<std::string> overrides{"learning_rate=1e-6", "buffer_chunks=4", "batch=4",
                                             "update_interval=1000000"};
    const std::string& name = policy->spec().name;
    Clients alone = OrDie(Clients::Connect(*one, name, count, overrides));
    Clients together = OrDie(Clients::Connect(*batched, name, count, overrides));
    for (Clients* clients : {&alone, &together}) OrDie(clients->Run({2, 3, true}));  // one update
    LoadResult sum_alone, sum_together;
    for (int i = 0; i < (table.slices + 1) / 2; ++i) {
      Add(OrDie(alone.Run({table.seconds, 0, false})), sum_alone);
      Add(OrDie(together.Run({table.seconds, 0, false})), sum_together);
    }
    std::printf("%8d | %14.1f %8.1f %8.1f | %14.1f %8.1f %8.1f | %6.2f\n", count, sum_alone.rate(),
                sum_alone.latencies.Quantile(0.5), sum_alone.latencies.Quantile(0.99),
                sum_together.rate(), sum_together.latencies.Quantile(0.5),
                sum_together.latencies.Quantile(0.99), sum_together.rate() / sum_alone.rate());
  }
  std::printf("after: %s\n", MachineNow().c_str());
}

int Main(int argc, char** argv) {
  for (int i = 1; i < argc; ++i) {
    if (std::string(argv[i]).starts_with("--benchmark")) {
      benchmark::Initialize(&argc, argv);
      benchmark::RunSpecifiedBenchmarks();
      return 0;
    }
  }
  TableOptions table;
  cli::App app{"Measures the policy server with its clients in one process, over the loopback.",
               "server_benchmark"};
  app.add_option("--seconds", table.seconds, "of a slice")->capture_default_str();
  app.add_option("--slices", table.slices, "of each kind")->capture_default_str();
  app.add_option("--threads", table.threads, "of the server")->capture_default_str();
  app.add_option("--arms", table.arms, "of the first table")->capture_default_str();
  app.add_option("--rate", table.rate_hz, "predictions of an arm per second")
      ->capture_default_str();
  app.add_option("--update-interval", table.update_interval, "chunks per update")
      ->capture_default_str();
  app.add_option("--updates-table", table.load, "predictions with and without updates");
  app.add_option("--batches-table", table.batches, "throughput by the number of clients");
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  std::setvbuf(stdout, nullptr, _IOLBF, 0);
  UseOneTorchThread();
  const std::shared_ptr<const FlowPolicy> nano = OrDie(LoadFlowPolicy("nano:random"));
  if (table.load) PrintUpdatesTable(table, nano);
  if (table.batches) {
    PrintBatchesTable(table, "nano on the processor", nano);
    PrintBatchesTable(table, "a device of 20 ms a pass and 1 ms a row (simulated by waiting)",
                      std::make_shared<DevicePolicy>());
  }
  return 0;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) { return robostress::Main(argc, argv); }
