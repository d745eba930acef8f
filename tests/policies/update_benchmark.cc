// What an update of batch 4 on stored prefixes costs beside one prediction: nano, and pi0 with
// every width an eighth of its own (three views of 224 pixels, 816 prefix tokens, 18 layers, K =
// 50), so that the shares of image encoder, prefix and action expert are pi0's. One thread; CPU
// time.
#include <benchmark/benchmark.h>
#include <torch/torch.h>

#include "adapter/lora_adapter.h"
#include "server/policies/openpi/flow.h"
#include "server/policies/openpi/openpi_lora.h"
#include "server/policy.h"

namespace robostress {
namespace {

using openpi::OpenpiConfig;

OpenpiConfig EighthOfPi0() {
  OpenpiConfig c;
  c.image = 224, c.patch = 14;
  c.vision_width = 1152 / 8, c.vision_depth = 27, c.vision_heads = 16, c.vision_mlp = 4304 / 8;
  c.prefix_width = 2048 / 8, c.prefix_mlp = 16384 / 8;
  c.expert_width = 1024 / 8, c.expert_mlp = 4096 / 8;
  c.depth = 18, c.heads = 8, c.kv_heads = 1, c.head_dim = 256 / 8;
  c.vocab = 1024, c.horizon = 50, c.action_dim = 32, c.prompt_tokens = 48;
  return c;
}

// The action expert of an openpi network as what an adapter learns on.
class OpenpiField : public VelocityField {
 public:
  explicit OpenpiField(openpi::OpenpiModel model)
      : model_(std::move(model)), targets_(openpi::ExpertLoraTargets(model_.config)) {}
  int64_t horizon() const override { return model_.config.horizon; }
  int64_t model_action_dim() const override { return model_.config.action_dim; }
  const std::vector<LoraTarget>& lora_targets() const override { return targets_; }
  torch::Tensor Velocity(const PolicyContext& context, const torch::Tensor& x_u,
                         const torch::Tensor& u, const LoraWeights* lora) const override {
    const openpi::OpenpiModel model = lora == nullptr ? model_ : WithLora(model_, *lora);
    const openpi::PrefixContext prefix{
        {context.keys, context.values}, context.prefix_mask, context.state, {}};
    return openpi::Velocity(model, openpi::SuffixOnCache(model, prefix, x_u, u));
  }
  openpi::PrefixContext Encode() const {
    openpi::ModelInputs inputs;
    const int64_t s = model_.config.image;
    for (int view = 0; view < 3; ++view) {
      inputs.images.push_back(torch::rand({1, 3, s, s}) * 2 - 1);
      inputs.image_masks.push_back(torch::ones({1}, torch::kBool));
    }
    inputs.tokens = torch::randint(model_.config.vocab, {1, model_.config.prompt_tokens});
    inputs.token_mask = torch::ones_like(inputs.tokens, torch::kBool);
    return openpi::EncodePrefix(model_, openpi::EmbedPrefix(model_, inputs),
                                torch::randn({1, model_.config.action_dim}));
  }
  const openpi::OpenpiModel& model() const { return model_; }

 private:
  openpi::OpenpiModel model_;
  std::vector<LoraTarget> targets_;
};

MethodOptions Ours(const benchmark::State& state) {
  MethodOptions options = *MakeMethod("ours");
  options.lora = state.range(0) ? LoraKind::kPerHead : LoraKind::kPerMatrix;
  return options;
}

void Update(benchmark::State& state, const VelocityField& field, const PolicyContext& context) {
  const auto adapter = *LoraAdapter::Create(&field, Ours(state), StreamKey("benchmark"));
  std::vector<std::shared_ptr<const TrainingChunk>> batch;
  for (int i = 0; i < 4; ++i) {
    batch.push_back(std::make_shared<const TrainingChunk>(
        TrainingChunk{context, torch::randn({field.horizon(), field.model_action_dim()})}));
  }
  uint64_t index = 0;
  for (auto _ : state) benchmark::DoNotOptimize(adapter->Update(index++, batch));
}

void Pi0EighthPredict(benchmark::State& state) {
  at::set_num_threads(1);
  torch::NoGradGuard no_grad;
  const OpenpiField field(openpi::RandomOpenpiModel(EighthOfPi0(), 1));
  const LoraWeights lora =
      InitialLora(field.lora_targets(), Ours(state).lora, 4, 0.01, StreamKey("benchmark"));
  const openpi::OpenpiModel adapted = WithLora(field.model(), lora);
  const torch::Tensor noise = torch::randn({1, field.horizon(), field.model_action_dim()});
  for (auto _ : state)
    benchmark::DoNotOptimize(openpi::IntegrateEuler(adapted, field.Encode(), noise, 10));
}
BENCHMARK(Pi0EighthPredict)->ArgName("per_head")->Arg(1)->Unit(benchmark::kMillisecond);

void Pi0EighthUpdate(benchmark::State& state) {
  at::set_num_threads(1);
  const OpenpiField field(openpi::RandomOpenpiModel(EighthOfPi0(), 1));
  PolicyContext context;
  {
    torch::NoGradGuard no_grad;
    const openpi::PrefixContext prefix = field.Encode();
    context = {prefix.cache.keys, prefix.cache.values, prefix.valid, prefix.state};
  }
  Update(state, field, context);
}
BENCHMARK(Pi0EighthUpdate)->ArgName("per_head")->Arg(1)->Arg(0)->Unit(benchmark::kMillisecond);

Observation GreyObservation(const PolicySpec& spec) {
  Observation observation;
  observation.instruction = "put the red bowl on the plate";
  for (const std::string& camera : spec.cameras) {
    Image image{spec.image_width, spec.image_height, {}};
    image.data.resize(size_t{3} * image.width * image.height, 127);
    observation.views.push_back({camera, image});
  }
  observation.proprioception = Eigen::VectorXf::Constant(spec.state_dim, 0.1f);
  return observation;
}

void NanoPredict(benchmark::State& state) {
  at::set_num_threads(1);
  torch::NoGradGuard no_grad;
  const auto policy = *LoadFlowPolicy("nano:random");
  const Observation observation = GreyObservation(policy->spec());
  const LoraWeights lora =
      InitialLora(policy->lora_targets(), Ours(state).lora, 4, 0.01, StreamKey("benchmark"));
  const torch::Tensor noise = torch::randn({1, policy->horizon(), policy->model_action_dim()});
  for (auto _ : state)
    benchmark::DoNotOptimize(policy->Sample(*policy->Encode(observation), noise, &lora));
}
BENCHMARK(NanoPredict)->ArgName("per_head")->Arg(1)->Arg(0)->Unit(benchmark::kMillisecond);

void NanoUpdate(benchmark::State& state) {
  at::set_num_threads(1);
  const auto policy = *LoadFlowPolicy("nano:random");
  Update(state, *policy, *policy->Encode(GreyObservation(policy->spec())));
}
BENCHMARK(NanoUpdate)->ArgName("per_head")->Arg(1)->Arg(0)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace robostress

BENCHMARK_MAIN();
