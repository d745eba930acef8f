#include "server/training/trainer.h"

#include <torch/types.h>

#include <chrono>
#include <cmath>
#include <thread>

#include "absl/strings/str_cat.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "server/inference/torch_threads.h"
#include "server/policies/nano/nano_policy.h"
#include "server/training/flow_objective.h"
#include "server/training/worst_case_actions.h"

namespace robostress {
namespace {

using torch::Tensor;

using Seconds = std::chrono::duration<double>;

constexpr double kBeta1 = 0.9, kAdamEpsilon = 1e-8;

// Flow loss and auxiliary loss of a batch from its prefix.
struct Losses {
  Tensor flow, aux;
};

Losses ComputeLosses(const NanoNetwork& network, const NanoNetwork::Prefix& prefix,
                     const DemoBatch& batch, const Tensor& actions, const FlowDraw& draw,
                     const Tensor& step_weights) {
  return {FlowLoss(network, prefix.context, actions, draw, step_weights),
          (prefix.aux - batch.aux).square().mean()};
}

NanoNetwork::Prefix EncodeBatch(const NanoNetwork& network, const DemoBatch& batch) {
  return network.EncodePrefix(batch.images, batch.words, batch.state, /*with_aux=*/true);
}

// Keys and values as they are stored: no gradient goes through them.
PolicyContext Detached(PolicyContext context) {
  for (Tensor& keys : context.keys) keys = keys.detach();
  for (Tensor& values : context.values) values = values.detach();
  return context;
}

}  // namespace

Trainer::Trainer(TrainOptions options, NanoModel model, const Demonstrations& demonstrations)
    : options_(std::move(options)),
      model_(std::move(model)),
      demonstrations_(demonstrations),
      table_(NanoTensorTable(model_.config)) {
  std::vector<Tensor> flat, decay;
  for (size_t i = 0; i < table_.size(); ++i) {
    flat.push_back(model_.tensors[i].detach().flatten());
    decay.push_back(torch::full({flat.back().size(0)}, table_[i].decays ? 1.0f : 0.0f));
  }
  parameters_ = torch::cat(flat);
  decay_ = torch::cat(decay);
  average_ = parameters_.clone();
  moment1_ = torch::zeros_like(parameters_);
  moment2_ = torch::zeros_like(parameters_);
  step_weights_ = torch::full({model_.config.horizon, 1}, options_.far_weight, torch::kFloat32);
  step_weights_.narrow(0, 0, std::min(options_.near_steps, model_.config.horizon)).fill_(1.0f);
  step_weights_ /= step_weights_.mean();
  for (int i = 0; i < options_.threads; ++i) {
    Replica replica;
    replica.gradient = torch::zeros_like(parameters_);
    replica.leaves = Slice(parameters_);
    const std::vector<Tensor> gradients = Slice(replica.gradient);
    for (size_t j = 0; j < replica.leaves.size(); ++j) {
      replica.leaves[j].set_requires_grad(true);
      replica.leaves[j].mutable_grad() = gradients[j];  // backward adds into the flat buffer
    }
    replica.network =
        std::make_unique<NanoNetwork>(model_.config, AssembleNano(model_.config, replica.leaves));
    replica.frozen = std::make_unique<NanoNetwork>(model_.config,
                                                   AssembleNano(model_.config, Slice(parameters_)));
    replicas_.push_back(std::move(replica));
  }
}

std::vector<Tensor> Trainer::Slice(const Tensor& flat) const {
  std::vector<Tensor> slices;
  int64_t first = 0;
  for (const NanoTensorInfo& info : table_) {
    const int64_t count = c10::multiply_integers(info.shape);
    slices.push_back(flat.detach().narrow(0, first, count).view(info.shape).detach());
    first += count;
  }
  return slices;
}

double Trainer::learning_rate() const {
  if (step_ < options_.warmup) {
    return options_.lr * static_cast<double>(step_ + 1) / static_cast<double>(options_.warmup);
  }
  const double span = static_cast<double>(std::max<int64_t>(1, options_.steps - options_.warmup));
  const double progress = std::min(1.0, static_cast<double>(step_ - options_.warmup) / span);
  return options_.final_lr +
         0.5 * (options_.lr - options_.final_lr) * (1.0 + std::cos(M_PI * progress));
}

StreamKey Trainer::KeyOf(int64_t step, int thread) const {
  return StreamKey("train").With(static_cast<int64_t>(options_.seed)).With(step).With(thread);
}

std::vector<int64_t> Trainer::DrawFrames(RandomStream& random) const {
  const std::vector<int64_t>& all = demonstrations_.training();
  std::vector<int64_t> frames(options_.batch / options_.threads);
  for (int64_t& frame : frames) frame = all[random.UniformInt(static_cast<int>(all.size()))];
  return frames;
}

absl::StatusOr<TrainLosses> Trainer::Backward(int thread) {
  UseOneTorchThread();
  try {
    Replica& replica = replicas_[thread];
    replica.gradient.zero_();
    const StreamKey key = KeyOf(step_, thread);
    RandomStream random(key);
    const auto start = std::chrono::steady_clock::now();
    const std::vector<int64_t> frames = DrawFrames(random);
    const Augmentation augmentation{options_.shift_px, options_.colour_jitter,
                                    options_.state_noise};
    RS_ASSIGN_OR_RETURN(const DemoBatch batch,
                        demonstrations_.Fill(frames, model_, augmentation, random));
    RandomStream upcoming(KeyOf(step_ + 1, thread));
    demonstrations_.WillNeed(DrawFrames(upcoming));
    replica.data_seconds += Seconds(std::chrono::steady_clock::now() - start).count();
    const FlowDraw draw = DrawFlow(static_cast<int64_t>(frames.size()), options_.draws,
                                   model_.config, key.With("flow").lo());
    const NanoNetwork::Prefix prefix = EncodeBatch(*replica.network, batch);
    WorstCase worst{batch.actions};
    if (options_.objective == Objective::kRobust) {
      worst = FindWorstCaseActions(*replica.frozen, Detached(prefix.context), batch.actions, draw,
                                   step_weights_, options_.robust);
    }
    const Losses losses =
        ComputeLosses(*replica.network, prefix, batch, worst.actions, draw, step_weights_);
    (losses.flow + losses.aux * options_.aux_weight).backward();
    return TrainLosses{losses.flow.item<double>(), losses.aux.item<double>(), worst.clean_loss};
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("training step ", step_, ": ", error.what()));
  }
}

absl::StatusOr<TrainLosses> Trainer::Step() {
  std::vector<absl::StatusOr<TrainLosses>> results(replicas_.size(), absl::UnknownError("not run"));
  std::vector<std::thread> threads;
  for (size_t i = 1; i < replicas_.size(); ++i) {
    threads.emplace_back([this, i, &results] {
      pthread_setname_np(pthread_self(), absl::StrCat("train-", i).c_str());
      results[i] = Backward(static_cast<int>(i));
    });
  }
  results[0] = Backward(0);
  for (std::thread& thread : threads) thread.join();
  TrainLosses mean;
  for (const auto& result : results) {
    RS_RETURN_IF_ERROR(result.status());
    mean.flow += result->flow / static_cast<double>(results.size());
    mean.aux += result->aux / static_cast<double>(results.size());
    mean.clean_flow += result->clean_flow / static_cast<double>(results.size());
  }
  if (!std::isfinite(mean.flow + mean.aux)) {
    return absl::FailedPreconditionError(
        absl::StrCat("training diverged at step ", step_, ": loss ", mean.flow, ", auxiliary loss ",
                     mean.aux, "; lower lr (now ", learning_rate(), ") and go on with --resume"));
  }
  Update();
  return mean;
}

double Trainer::data_seconds() const {
  double sum = 0;
  for (const Replica& replica : replicas_) sum += replica.data_seconds;
  return sum;
}

void Trainer::Update() {
  torch::NoGradGuard no_grad;
  Tensor gradient = replicas_[0].gradient;
  for (size_t i = 1; i < replicas_.size(); ++i) gradient.add_(replicas_[i].gradient);
  gradient.div_(static_cast<double>(replicas_.size()));
  gradient_norm_ = gradient.norm().item<double>();
  if (gradient_norm_ > options_.clip) gradient.mul_(options_.clip / gradient_norm_);
  const double lr = learning_rate(), count = static_cast<double>(step_ + 1);
  moment1_.mul_(kBeta1).add_(gradient, 1.0 - kBeta1);
  moment2_.mul_(options_.beta2).addcmul_(gradient, gradient, 1.0 - options_.beta2);
  const double correction1 = 1.0 - std::pow(kBeta1, count),
               correction2 = 1.0 - std::pow(options_.beta2, count);
  parameters_.sub_(parameters_ * decay_, lr * options_.weight_decay);
  parameters_.addcdiv_(moment1_, (moment2_ / correction2).sqrt_().add_(kAdamEpsilon),
                       -lr / correction1);
  const double decay = std::min(options_.ema, (1.0 + count) / (10.0 + count));
  average_.lerp_(parameters_, 1.0 - decay);
  ++step_;
}

NanoModel Trainer::Published() const {
  NanoModel model = model_;
  model.tensors = Slice(average_.clone());
  return model;
}

absl::StatusOr<Evaluation> Trainer::Evaluate() const {
  const std::vector<int64_t>& held_out = demonstrations_.validation();
  if (held_out.empty()) {
    return absl::FailedPreconditionError(
        "no held-out episodes; record more or raise validation_share");
  }
  UseOneTorchThread();
  try {
    torch::NoGradGuard no_grad;
    const NanoModel model = Published();
    const NanoConfig& config = model.config;
    const NanoNetwork network(config, AssembleNano(config, model.tensors));
    const int64_t count =
        std::min<int64_t>(options_.validation_frames, static_cast<int64_t>(held_out.size()));
    constexpr int64_t kRows = 64;
    Evaluation sum;
    int64_t rows_done = 0;
    for (int64_t first = 0; first < count; first += kRows) {
      std::vector<int64_t> frames;
      for (int64_t i = first; i < std::min(count, first + kRows); ++i) {
        frames.push_back(held_out[i * static_cast<int64_t>(held_out.size()) / count]);
      }
      const int64_t rows = static_cast<int64_t>(frames.size());
      RandomStream random(StreamKey("evaluate").With(first));
      RS_ASSIGN_OR_RETURN(const DemoBatch batch, demonstrations_.Fill(frames, model, {}, random));
      const NanoNetwork::Prefix prefix = EncodeBatch(network, batch);
      const Losses losses =
          ComputeLosses(network, prefix, batch, batch.actions,
                        DrawFlow(rows, options_.draws, config, 17 + first), step_weights_);
      sum.losses.flow += losses.flow.item<double>() * rows;
      sum.losses.aux += losses.aux.item<double>() * rows;

      Tensor x = DrawFlow(rows, 1, config, 91 + first).noise;
      for (const float t : EulerTimes(10)) {
        x.add_(network.Velocity(prefix.context, x, torch::full({rows}, t), nullptr), -0.1);
      }
      const Tensor scale = torch::tensor(model.actions.std),
                   mean = torch::tensor(model.actions.mean);
      const int64_t motion = config.action_dim - 1;
      const auto commands = [&](const Tensor& chunk) {
        return chunk.narrow(1, 0, config.execute_steps).narrow(2, 0, config.action_dim) * scale +
               mean;
      };
      const Tensor sampled = commands(x), expert = commands(batch.actions);
      sum.action_error +=
          (sampled - expert).narrow(2, 0, motion).abs().mean().item<double>() * rows;
      sum.gripper_agreement += (sampled.select(2, motion).gt(0) == expert.select(2, motion).gt(0))
                                   .to(torch::kFloat32)
                                   .mean()
                                   .item<double>() *
                               rows;
      const Tensor metres = (prefix.aux - batch.aux) * torch::tensor(model.aux.std);
      sum.target_error_mm += metres.narrow(1, 0, 3).norm(2, 1).mean().item<double>() * 1e3 * rows;
      sum.destination_error_mm +=
          metres.narrow(1, 3, 3).norm(2, 1).mean().item<double>() * 1e3 * rows;
      rows_done += rows;
    }
    for (double* value :
         {&sum.losses.flow, &sum.losses.aux, &sum.action_error, &sum.gripper_agreement,
          &sum.target_error_mm, &sum.destination_error_mm}) {
      *value /= static_cast<double>(rows_done);
    }
    return sum;
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("evaluation at step ", step_, ": ", error.what()));
  }
}

absl::Status Trainer::SaveCheckpoint(const std::string& path) const {
  SafetensorsWriter writer;
  writer.SetMetadata("format", "robostress-nano-checkpoint");
  const auto add = [&](const char* name, const Tensor& flat) {
    writer.AddFloats(name, {flat.size(0)},
                     absl::MakeConstSpan(flat.data_ptr<float>(), flat.size(0)));
  };
  add("parameters", parameters_);
  add("average", average_);
  add("moment1", moment1_);
  add("moment2", moment2_);
  writer.AddInts("step", {1}, absl::MakeConstSpan(&step_, 1));
  return writer.Write(path);
}

absl::Status Trainer::LoadCheckpoint(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(path));
  const auto read = [&](const char* name, Tensor& flat) -> absl::Status {
    RS_ASSIGN_OR_RETURN(const std::vector<float> values, file.ReadFloats(name, {flat.size(0)}));
    std::copy(values.begin(), values.end(), flat.data_ptr<float>());
    return absl::OkStatus();
  };
  RS_RETURN_IF_ERROR(read("parameters", parameters_));
  RS_RETURN_IF_ERROR(read("average", average_));
  RS_RETURN_IF_ERROR(read("moment1", moment1_));
  RS_RETURN_IF_ERROR(read("moment2", moment2_));
  RS_ASSIGN_OR_RETURN(const std::vector<double> step, file.ReadDoubles("step", {1}));
  step_ = static_cast<int64_t>(step[0]);
  return absl::OkStatus();
}

}  // namespace robostress
