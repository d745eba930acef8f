// What the server costs with nano at its real size and random weights, one core.
#include <benchmark/benchmark.h>

#include "server/session.h"
#include "server/torch_threads.h"
#include "tests/adapter/toy_arm.h"

namespace robostress {
namespace {

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

struct Bench {
  explicit Bench(const std::string& method) : adaptation(1), inference(1) {
    UseOneTorchThread();
    policy = *LoadFlowPolicy("nano:random");
    observation = BlankObservation(policy->spec());
    SessionSpec spec;
    spec.suite = "tabletop_goal";
    spec.scenario = "clean";
    spec.policy = "nano";
    spec.method = *MakeMethod(method);
    spec.method.learning_rate = 1e-6;
    session = *Session::Create(spec, {policy, &adaptation, &inference}, 1);
    session->StartEpisode(0, 0, 0).IgnoreError();
  }
  PredictedChunk Predict() { return *session->Predict(observation, 0, 0, chunk++, sequence); }
  void Feedback(const PredictedChunk& prediction) {
    ExecutedChunk executed = ToyArm(0.6).Execute(prediction, 5);
    executed.chunk = chunk - 1;
    executed.sequence = ++sequence;
    session->Feedback(executed).IgnoreError();
  }

  AdaptationLoop adaptation;
  std::counting_semaphore<> inference;
  std::shared_ptr<const FlowPolicy> policy;
  Observation observation;
  std::shared_ptr<Session> session;
  int chunk = 0;
  uint64_t sequence = 0;
};

void Encode(benchmark::State& state) {
  Bench bench("base");
  for (auto _ : state) benchmark::DoNotOptimize(bench.policy->Encode(bench.observation));
}
BENCHMARK(Encode)->Unit(benchmark::kMillisecond);

void PredictBase(benchmark::State& state) {
  Bench bench("base");
  for (auto _ : state) bench.Feedback(bench.Predict());
}
BENCHMARK(PredictBase)->Unit(benchmark::kMillisecond);

// With LoRA and, beside it, the unadapted policy's chunk on the same prefix.
void PredictAdaptedAndBase(benchmark::State& state) {
  Bench bench("ours");
  for (int i = 0; i < 32; ++i) bench.Feedback(bench.Predict());
  for (auto _ : state) benchmark::DoNotOptimize(bench.Predict());
}
BENCHMARK(PredictAdaptedAndBase)->Unit(benchmark::kMillisecond);

// One Adam step on four chunks with stored prefix keys and values.
void Update(benchmark::State& state) {
  UseOneTorchThread();
  Bench bench("ours");
  MethodOptions options = *MakeMethod("ours");
  const auto adapter = *LoraAdapter::Create(bench.policy.get(), options, StreamKey("bench"));
  auto chunk = std::make_shared<TrainingChunk>();
  chunk->context = *bench.policy->Encode(bench.observation);
  chunk->target = torch::zeros({bench.policy->horizon(), bench.policy->model_action_dim()});
  uint64_t index = 0;
  for (auto _ : state)
    benchmark::DoNotOptimize(adapter->Update(index++, {chunk, chunk, chunk, chunk}));
}
BENCHMARK(Update)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace robostress

BENCHMARK_MAIN();
