// Times predictions of nano, pi0 and pi0.5, and their matrix products alone. With --files it writes
// weights, inputs and actions for the eager networks of tests/server/policies/eager, whose
// compare.sh runs both in turn. With --update it times an update of batch 4 on stored prefixes
// beside predictions that carry its adapter.

#include <gtest/gtest.h>
#include <torch/types.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <iostream>

#include "adapter/lora_adapter.h"
#include "common/command_line.h"
#include "common/run_main.h"
#include "common/statistics.h"
#include "server/policies/kernels/fused_kernels.h"
#include "server/policies/nano/nano_policy.h"
#include "server/policies/openpi/compute_threads.h"
#include "server/policies/openpi/openpi_inference.h"
#include "server/policies/openpi/openpi_lora.h"
#include "tests/server/policies/tiny_openpi.h"

namespace robostress::openpi {
namespace {

// One matrix product of a prediction, [m, k] times [k, n], `times` in a row.
struct Product {
  int64_t m, k, n, times;
};

// [begin, end) of a prediction in processor and in wall time, ms.
struct Time {
  double cpu = 0, wall = 0;
};

template <class F>
Time Measure(F&& f) {
  const auto wall = std::chrono::steady_clock::now();
  timespec begin, end;
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &begin);
  f();
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &end);
  return {
      1e3 * static_cast<double>(end.tv_sec - begin.tv_sec) +
          1e-6 * static_cast<double>(end.tv_nsec - begin.tv_nsec),
      std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - wall).count()};
}

// The products of a prediction with random matrices of their shapes, each through LibTorch or
// through nano's kernel of packed weights.
class Products {
 public:
  Products(const std::vector<Product>& products, torch::Dtype dtype) {
    for (const Product& p : products) {
      entries_.push_back({p,
                          at::randn({p.m, p.k}).to(dtype),
                          at::randn({p.n, p.k}).to(dtype),
                          at::empty({p.m, p.n}, dtype),
                          {}});
      if (dtype != torch::kFloat32) continue;
      entries_.back().panels = at::randn({PadToPanel(p.n), p.k});
    }
  }
  void RunLibTorch() {
    for (Entry& e : entries_)
      for (int64_t i = 0; i < e.product.times; ++i) at::mm_out(e.y, e.x, e.w.t());
  }
  void RunPacked() {
    for (Entry& e : entries_) {
      const Product& p = e.product;
      for (int64_t i = 0; i < p.times; ++i) {
        BestFusedKernels().linear(e.x.data_ptr<float>(), p.m, p.k, e.panels.data_ptr<float>(), p.n,
                                  e.y.data_ptr<float>());
      }
    }
  }

 private:
  struct Entry {
    Product product;
    torch::Tensor x, w, y, panels;
  };
  std::vector<Entry> entries_;
};

// Something whose predictions are timed.
struct Subject {
  virtual ~Subject() = default;
  virtual void Encode() = 0;
  virtual void Sample(const LoraWeights* lora) = 0;  // after Encode
  virtual const PolicyContext& context() const = 0;  // after Encode
  virtual const VelocityField& field() const = 0;    // what an adapter learns on
  virtual std::vector<Product> EncodeProducts() const = 0;
  virtual std::vector<Product> SampleProducts() const = 0;
  virtual void WriteFiles(const std::string& folder) = 0;
};

class NanoSubject : public Subject {
 public:
  NanoSubject() : model_(RandomNanoModel({}, 7)) {
    torch::manual_seed(1);
    observation_.instruction = "put the red bowl on the plate";
    const NanoConfig& c = model_.config;
    for (const std::string& camera : c.cameras) {
      Image image{c.image_size, c.image_size, {}};
      const torch::Tensor pixels =
          at::randint(256, {c.image_size, c.image_size, 3}).to(torch::kUInt8);
      image.data.assign(pixels.data_ptr<uint8_t>(), pixels.data_ptr<uint8_t>() + pixels.numel());
      observation_.views.push_back({camera, image});
      pixels_.push_back(pixels);
    }
    observation_.proprioception = Eigen::VectorXf::Constant(c.state_dim, 0.1f);
    noise_ = at::randn({1, c.horizon, c.model_action_dim});
    policy_ = MakeNanoPolicy(model_, "", "nano").value();
  }
  void Encode() override { context_ = policy_->Encode(observation_).value(); }
  void Sample(const LoraWeights* lora) override {
    actions_ = policy_->Sample(context_, noise_, lora);
  }
  const PolicyContext& context() const override { return context_; }
  const VelocityField& field() const override { return *policy_; }

  std::vector<Product> EncodeProducts() const override {
    const NanoConfig& c = model_.config;
    const int64_t cameras = static_cast<int64_t>(c.cameras.size()), tokens = c.prefix_tokens();
    const int64_t w = c.prefix_width, h = c.head_dim;
    std::vector<Product> products;
    int64_t in = 3, side = c.image_size / 2;
    for (size_t i = 0; i < c.conv_channels.size(); ++i, side /= 2) {
      products.push_back({side * side, in * (i == 0 ? 25 : 9), c.conv_channels[i], cameras});
      in = c.conv_channels[i];
    }
    products.push_back({c.image_tokens(), in, w, cameras});
    AppendLayers(c, tokens, tokens, w, c.prefix_mlp, c.layers - 1, products);
    products.push_back({tokens, w, 2 * h, 1});
    return products;
  }
  std::vector<Product> SampleProducts() const override {
    const NanoConfig& c = model_.config;
    const int64_t steps = 10, tokens = c.action_tokens(), e = c.expert_width;
    const int64_t values = int64_t{c.steps_per_token} * c.model_action_dim;
    // What the sampler computes: the state's tokens once, the action tokens in every step.
    std::vector<Product> products = {{1, c.state_dim, e, 1},
                                     {tokens, values, e, steps},
                                     {tokens, e, e, 2 * steps},
                                     {tokens, e, values, steps}};
    AppendLayers(c, 1, c.prefix_tokens() + 1, e, c.expert_mlp, c.layers, products);
    AppendLayers(c, tokens, c.prefix_tokens() + 1 + tokens, e, c.expert_mlp, c.layers * steps,
                 products);
    return products;
  }
  void WriteFiles(const std::string& folder) override {
    Encode();
    Sample(nullptr);
    const absl::Status saved = SaveNanoModel(model_, folder + "/weights.safetensors");
    EXPECT_TRUE(saved.ok()) << saved;
    TensorMap io = {
        {"inputs/tokens",
         torch::tensor(
             model_.vocabulary.Encode(observation_.instruction, model_.config.max_words).value(),
             torch::kInt64)
             .unsqueeze(0)},
        {"inputs/state", context_.state},
        {"inputs/noise", noise_},
        {"expected/actions", actions_}};
    for (size_t i = 0; i < pixels_.size(); ++i)
      io[absl::StrCat("inputs/image.", i)] = pixels_[i].to(torch::kInt64);
    WriteTensors(folder + "/io.safetensors", io, {});
  }

 private:
  static void AppendLayers(const NanoConfig& c, int64_t tokens, int64_t keys, int64_t width,
                           int64_t mlp, int64_t times, std::vector<Product>& products) {
    const int64_t heads = c.heads, h = c.head_dim;
    products.push_back({tokens, width, (heads + 2) * h, times});
    products.push_back({tokens * heads, h, keys, times});
    products.push_back({tokens * heads, keys, h, times});
    products.push_back({tokens, heads * h, width, times});
    products.push_back({tokens, width, 2 * mlp, times});
    products.push_back({tokens, mlp, width, times});
  }

  NanoModel model_;
  std::unique_ptr<FlowPolicy> policy_;
  Observation observation_;
  std::vector<torch::Tensor> pixels_;
  torch::Tensor noise_, actions_;
  PolicyContext context_;
};

// pi0 or pi0.5 as published, its widths divided by `by`.
OpenpiConfig Scaled(bool pi05, int64_t by) {
  OpenpiConfig c;
  c.pi05 = pi05;
  c.image = 224, c.patch = 14;
  c.vision_width = 1152 / by, c.vision_depth = 27, c.vision_mlp = 4304 / by;
  c.vision_heads = 16 / by;
  c.prefix_width = 2048 / by, c.prefix_mlp = 16384 / by;
  c.expert_width = 1024 / by, c.expert_mlp = 4096 / by;
  c.depth = 18, c.heads = 8, c.kv_heads = 1, c.head_dim = 256 / by;
  c.vocab = 257152 / by, c.horizon = 50, c.action_dim = 32, c.prompt_tokens = pi05 ? 200 : 48;
  return c;
}

// Random weights in their final dtype, so that a full-size network fits into memory.
OpenpiModel RandomModel(const OpenpiConfig& config, torch::Dtype dtype) {
  struct Fill : ParameterVisitor {
    void OnTensor(const std::string&, const std::vector<int64_t>& shape,
                  torch::Tensor& tensor) override {
      int64_t in = 1;
      for (size_t i = 1; i < shape.size(); ++i) in *= shape[i];
      const double bound = shape.size() > 1 ? std::sqrt(3.0 / static_cast<double>(in)) : 0.1;
      tensor = at::empty(shape, dtype).uniform_(-bound, bound);
    }
    torch::Dtype dtype = torch::kFloat32;
  } fill;
  fill.dtype = dtype;
  torch::manual_seed(5);
  OpenpiModel model;
  model.config = config;
  VisitParameters(config, model.weights, fill);
  return model;
}

// The action expert of an openpi network as a served policy gives it to an adapter: bfloat16
// weights are widened for each update where the processor does not multiply them.
class OpenpiField : public VelocityField {
 public:
  explicit OpenpiField(OpenpiModel model)
      : model_(std::move(model)), targets_(ExpertLoraTargets(model_.config)) {}
  int64_t horizon() const override { return model_.config.horizon; }
  int64_t model_action_dim() const override { return model_.config.action_dim; }
  const std::vector<LoraTarget>& lora_targets() const override { return targets_; }
  ContextShape context_shape() const override {
    const OpenpiConfig& c = model_.config;
    return {.layers = c.depth,
            .kv_heads = c.kv_heads,
            .head_dim = c.head_dim,
            .kv_type = torch::kFloat32,
            .max_prefix = 3 * c.patches() + c.prompt_tokens,
            .state_dim = c.action_dim};
  }
  torch::Tensor Velocity(const PolicyContext& context, const torch::Tensor& x_u,
                         const torch::Tensor& u, const LoraWeights* lora) const override {
    const bool widen = context.keys[0].scalar_type() == torch::kBFloat16 &&
                       !MultipliesBf16(context.keys[0].device());
    const OpenpiModel adapted = WithLora(widen ? WithFloat32Expert(model_) : model_, *lora);
    const PrefixContext prefix{
        {context.keys, context.values}, context.prefix_mask, context.state, {}};
    return openpi::Velocity(adapted, SuffixOnCache(adapted, prefix, x_u, u));
  }

 private:
  OpenpiModel model_;
  std::vector<LoraTarget> targets_;
};

class OpenpiSubject : public Subject {
 public:
  // `cameras` of three slots hold a view and `words` prompt tokens are given; the rest is masked.
  OpenpiSubject(const OpenpiConfig& config, const InferenceOptions& options, int64_t cameras,
                int64_t words)
      : config_(config),
        inputs_(RandomInputs(config, 1, 3, false, 11)),
        cameras_(cameras),
        words_(words) {
    for (int64_t i = cameras; i < 3; ++i) inputs_.model.image_masks[i].fill_(false);
    inputs_.model.token_mask.narrow(1, words, config.prompt_tokens - words).fill_(false);
    const bool bf16 = options.precision == Precision::kBf16;
    OpenpiModel model = RandomModel(config, bf16 ? torch::kBFloat16 : torch::kFloat32);
    auto made = OpenpiInference::Create(model, options);
    EXPECT_TRUE(made.ok()) << made.status();
    inference_ = std::move(made).value();
    weights_ = WeightTensors(model);  // shared with the inference
    field_ = std::make_unique<OpenpiField>(std::move(model));
  }
  void Encode() override { context_ = inference_->Encode(inputs_.model).value(); }
  void Sample(const LoraWeights* lora) override {
    actions_ = inference_->Sample(context_, inputs_.noise, lora).value();
  }
  const PolicyContext& context() const override { return context_; }
  const VelocityField& field() const override { return *field_; }

  std::vector<Product> EncodeProducts() const override {
    const OpenpiConfig& c = config_;
    const int64_t patches = c.patches() * cameras_, v = c.vision_width, head = v / c.vision_heads;
    const int64_t attentions = c.vision_depth * cameras_ * c.vision_heads;
    std::vector<Product> products = {{patches, 3 * c.patch * c.patch, v, 1},
                                     {patches, v, 3 * v, c.vision_depth},
                                     {c.patches(), head, c.patches(), attentions},
                                     {c.patches(), c.patches(), head, attentions},
                                     {patches, v, v, c.vision_depth},
                                     {patches, v, c.vision_mlp, c.vision_depth},
                                     {patches, c.vision_mlp, v, c.vision_depth},
                                     {patches, v, c.prefix_width, 1}};
    const int64_t tokens = patches + words_;
    AppendLayers(tokens, tokens, c.prefix_width, c.prefix_mlp, c.depth - 1, products);
    products.push_back({tokens, c.prefix_width, 2 * c.kv_heads * c.head_dim, 1});
    return products;
  }
  std::vector<Product> SampleProducts() const override {
    const OpenpiConfig& c = config_;
    const int64_t steps = 10, tokens = c.suffix_tokens(), w = c.expert_width;
    std::vector<Product> products = {{c.horizon, c.action_dim, w, steps},
                                     {c.horizon, w, c.action_dim, steps}};
    if (!c.pi05) products.push_back({c.horizon, w, w, 2 * steps});
    AppendLayers(tokens, c.patches() * cameras_ + words_ + tokens, w, c.expert_mlp, c.depth * steps,
                 products);
    return products;
  }
  void WriteFiles(const std::string& folder) override {
    Encode();
    Sample(nullptr);
    WriteTensors(folder + "/weights.safetensors", weights_, {{"config", ConfigJson(config_)}});
    TensorMap io = InputTensors(inputs_);
    io["expected/actions"] = actions_;
    WriteTensors(folder + "/io.safetensors", io, {});
  }

 private:
  void AppendLayers(int64_t tokens, int64_t keys, int64_t width, int64_t mlp, int64_t times,
                    std::vector<Product>& products) const {
    const int64_t heads = config_.heads, h = config_.head_dim;
    products.push_back({tokens, width, (heads + 2 * config_.kv_heads) * h, times});
    products.push_back({tokens * heads, h, keys, times});
    products.push_back({tokens * heads, keys, h, times});
    products.push_back({tokens, heads * h, width, times});
    products.push_back({tokens, width, 2 * mlp, times});
    products.push_back({tokens, mlp, width, times});
  }

  OpenpiConfig config_;
  OracleInputs inputs_;
  int64_t cameras_, words_;
  std::unique_ptr<OpenpiInference> inference_;
  std::unique_ptr<OpenpiField> field_;
  TensorMap weights_;
  PolicyContext context_;
  torch::Tensor actions_;
};

// Updates of the paper's method, batch 4, on the subject's context, and their adapter.
class Updates {
 public:
  Updates(const Subject& subject, LoraKind kind) {
    LoraOptions options = LoraOptions::At(1e-4);
    options.kind = kind;
    adapter_ = LoraAdapter::Create(&subject.field(), options, StreamKey("benchmark")).value();
    for (int i = 0; i < kBatch; ++i) {
      batch_.push_back(std::make_shared<const TrainingChunk>(TrainingChunk{
          subject.context(),
          at::randn({subject.field().horizon(), subject.field().model_action_dim()})}));
    }
  }
  void Run() {
    const at::AutoGradMode record(true);
    EXPECT_TRUE(adapter_->Update(index_++, batch_).value().applied);
  }
  std::shared_ptr<const LoraWeights> lora() const { return adapter_->snapshot(); }

  static constexpr int kBatch = 4;

 private:
  std::unique_ptr<LoraAdapter> adapter_;
  std::vector<std::shared_ptr<const TrainingChunk>> batch_;
  uint64_t index_ = 0;
};

double GigaFlops(const std::vector<Product>& products) {
  double flops = 0;
  for (const Product& p : products) flops += 2e-9 * static_cast<double>(p.m * p.k * p.n * p.times);
  return flops;
}

// Of the products alone. An update is one step of ten per chunk, forward and as much backward: no
// weight and nothing of the prefix has a gradient, so that each product has one partner.
void PrintFlops(const Subject& subject) {
  const double encode = GigaFlops(subject.EncodeProducts());
  const double sample = GigaFlops(subject.SampleProducts());
  const double update = 2 * Updates::kBatch * sample / 10;
  std::printf("GFLOP: encode %.2f, sample %.2f, update %.2f = %.3f of a prediction\n", encode,
              sample, update, update / (encode + sample));
}

// What a round times, in this order.
struct Timings {
  std::vector<std::string> names;
  std::vector<std::function<void()>> runs;
};

struct Options {
  std::string subject = "nano", precision = "float32", device = "cpu", files, update;
  int64_t scale = 8, cameras = 2, words = 20, rounds = 20;
  int threads = 1;
  bool lockstep = false, products = true;
};

std::unique_ptr<Subject> MakeSubject(const Options& options) {
  if (options.subject == "nano") return std::make_unique<NanoSubject>();
  return std::make_unique<OpenpiSubject>(
      Scaled(options.subject == "pi05", options.scale),
      InferenceOptions{
          .precision = options.precision == "bf16" ? Precision::kBf16 : Precision::kFloat32,
          .device = options.device},
      options.cameras, options.words);
}

// One line of a round: name=cpu,wall ...
void PrintRound(const Timings& timings) {
  for (size_t i = 0; i < timings.runs.size(); ++i) {
    const Time time = Measure(timings.runs[i]);
    std::printf("%s%s=%.4f,%.4f", i == 0 ? "" : " ", timings.names[i].c_str(), time.cpu, time.wall);
  }
  std::printf("\n");
  std::fflush(stdout);
}

void PrintTable(const Timings& timings, int64_t rounds) {
  std::vector<std::vector<double>> cpu(timings.runs.size()), wall(timings.runs.size());
  for (int64_t round = 0; round < rounds; ++round) {
    for (size_t i = 0; i < timings.runs.size(); ++i) {
      const Time time = Measure(timings.runs[i]);
      cpu[i].push_back(time.cpu);
      wall[i].push_back(time.wall);
    }
  }
  std::printf("%-22s %12s %12s %12s %12s   [ms]\n", "", "cpu min", "cpu p50", "cpu p99",
              "wall p50");
  for (size_t i = 0; i < timings.runs.size(); ++i) {
    std::sort(cpu[i].begin(), cpu[i].end());
    std::sort(wall[i].begin(), wall[i].end());
    std::printf("%-22s %12.3f %12.3f %12.3f %12.3f\n", timings.names[i].c_str(),
                Quantile(cpu[i], 0), Quantile(cpu[i], 0.5), Quantile(cpu[i], 0.99),
                Quantile(wall[i], 0.5));
  }
}

int Run(const Options& options) {
  const torch::NoGradGuard no_grad;
  SetComputeThreads(options.threads);
  const std::unique_ptr<Subject> subject = MakeSubject(options);
  if (!options.files.empty()) subject->WriteFiles(options.files);
  Products of_encode(options.products ? subject->EncodeProducts() : std::vector<Product>(),
                     torch::kFloat32);
  Products of_sample(options.products ? subject->SampleProducts() : std::vector<Product>(),
                     torch::kFloat32);
  std::unique_ptr<Updates> updates;
  std::shared_ptr<const LoraWeights> lora;
  if (!options.update.empty()) {
    subject->Encode();
    updates = std::make_unique<Updates>(
        *subject, options.update == "per_head" ? LoraKind::kPerHead : LoraKind::kPerMatrix);
    lora = updates->lora();
    PrintFlops(*subject);
  }
  Timings timings = {{"encode", "sample"},
                     {[&] { subject->Encode(); }, [&] { subject->Sample(lora.get()); }}};
  const auto add = [&](const std::string& name, std::function<void()> run) {
    timings.names.push_back(name);
    timings.runs.push_back(std::move(run));
  };
  if (updates != nullptr) add("update", [&] { updates->Run(); });
  if (options.products) {
    add("encode_products", [&] { of_encode.RunLibTorch(); });
    add("sample_products", [&] { of_sample.RunLibTorch(); });
    add("encode_packed", [&] { of_encode.RunPacked(); });
    add("sample_packed", [&] { of_sample.RunPacked(); });
  }
  if (!options.lockstep) {
    PrintTable(timings, options.rounds);
    return 0;
  }
  std::printf("ready\n");
  std::fflush(stdout);
  for (std::string line; std::getline(std::cin, line);) PrintRound(timings);
  return 0;
}

}  // namespace
}  // namespace robostress::openpi

int main(int argc, char** argv) {
  robostress::openpi::Options options;
  robostress::cli::App app(
      "Times predictions of nano, pi0 and pi0.5 beside their matrix products alone.");
  app.add_option("--policy", options.subject)
      ->check(robostress::cli::IsMember({"nano", "pi0", "pi05"}));
  app.add_option("--scale", options.scale, "widths of pi0 and pi0.5 divided by this")
      ->check(robostress::cli::IsMember({"1", "2", "4", "8"}));
  app.add_option("--precision", options.precision)
      ->check(robostress::cli::IsMember({"float32", "bf16"}));
  app.add_option("--device", options.device);
  app.add_option("--threads", options.threads)->check(robostress::cli::Range(1, 1024));
  app.add_option("--cameras", options.cameras, "of three that hold a view")
      ->check(robostress::cli::Range(1, 3));
  app.add_option("--words", options.words, "prompt tokens that are not padding")
      ->check(robostress::cli::Range(1, 48));
  app.add_option("--rounds", options.rounds)->check(robostress::cli::Range(1, 100000));
  app.add_flag("--products,!--no-products", options.products, "time the matrix products too");
  app.add_option("--update", options.update, "also time an update of batch 4")
      ->check(robostress::cli::IsMember({"per_head", "per_matrix"}));
  app.add_option("--files", options.files, "existing folder for weights, inputs and actions")
      ->check(robostress::cli::ExistingDirectory());
  app.add_flag("--lockstep", options.lockstep, "one round per line on standard input");
  if (const auto code = robostress::ParseCommandLine(app, argc, argv)) return *code;
  return robostress::openpi::Run(options);
}
