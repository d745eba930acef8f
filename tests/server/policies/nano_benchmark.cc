#include <ATen/Parallel.h>
#include <benchmark/benchmark.h>
#include <torch/types.h>

#include "server/policies/policy.h"

// Times one prediction of nano: the prefix (Encode), ten Euler steps (Sample), and one expert pass.
namespace robostress {
namespace {

Observation SomeObservation(const PolicySpec& spec) {
  Observation observation;
  observation.instruction = "put the red bowl on the plate";
  for (const std::string& camera : spec.cameras) {
    Image image{spec.image_width, spec.image_height, {}};
    image.data.resize(size_t{3} * image.width * image.height);
    for (size_t i = 0; i < image.data.size(); ++i)
      image.data[i] = static_cast<uint8_t>(i * 37 % 251);
    observation.views.push_back({camera, image});
  }
  observation.proprioception = Eigen::VectorXf::Constant(spec.state_dim, 0.1f);
  return observation;
}

LoraWeights SomeLora(const FlowPolicy& policy) {
  LoraWeights lora;
  for (const LoraTarget& target : policy.lora_targets()) {
    lora.A.push_back(torch::randn({4, target.in_features}) * 0.01);
    lora.B.push_back(torch::zeros({target.out_features, 4}));
  }
  return lora;
}

void BM_Encode(benchmark::State& state) {
  at::set_num_threads(1);
  const auto policy = LoadFlowPolicy("nano:random").value();
  const Observation observation = SomeObservation(policy->spec());
  for ([[maybe_unused]] auto _ : state)
    benchmark::DoNotOptimize(policy->Encode(observation).value());
}
BENCHMARK(BM_Encode)->Unit(benchmark::kMillisecond);

void BM_Sample(benchmark::State& state) {
  at::set_num_threads(1);
  const auto policy = LoadFlowPolicy("nano:random").value();
  const PolicyContext context = policy->Encode(SomeObservation(policy->spec())).value();
  const torch::Tensor noise = torch::randn({1, policy->horizon(), policy->model_action_dim()});
  const LoraWeights lora = SomeLora(*policy);
  for ([[maybe_unused]] auto _ : state)
    benchmark::DoNotOptimize(policy->Sample(context, noise, state.range(0) ? &lora : nullptr));
}
BENCHMARK(BM_Sample)->ArgName("lora")->Arg(0)->Arg(1)->Unit(benchmark::kMillisecond);

// Rows with adapters of their own in one pass; the time is that of all rows.
void BM_SampleRows(benchmark::State& state) {
  at::set_num_threads(1);
  const auto policy = LoadFlowPolicy("nano:random").value();
  const PolicyContext context = policy->Encode(SomeObservation(policy->spec())).value();
  const auto batch = static_cast<size_t>(state.range(0));
  const torch::Tensor noise =
      torch::randn({state.range(0), policy->horizon(), policy->model_action_dim()});
  std::vector<LoraWeights> adapters;
  for (size_t i = 0; i < batch; ++i) adapters.push_back(SomeLora(*policy));
  std::vector<const LoraWeights*> rows;
  for (const LoraWeights& adapter : adapters) rows.push_back(&adapter);
  const PolicyContext contexts = StackContexts(std::vector<const PolicyContext*>(batch, &context));
  for ([[maybe_unused]] auto _ : state)
    benchmark::DoNotOptimize(policy->SampleRows(contexts, noise, rows));
  state.SetItemsProcessed(state.iterations() * state.range(0));
}
BENCHMARK(BM_SampleRows)
    ->ArgName("rows")
    ->RangeMultiplier(2)
    ->Range(1, 16)
    ->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace robostress

BENCHMARK_MAIN();
