#include "server/sessions/prediction.h"

#include <torch/types.h>

#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/command_bounds.h"
#include "adapter/method_options.h"
#include "adapter/thrown_status.h"
#include "common/rollout/noise_key.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

// What a policy may answer and a session may keep: numbers, and actions that are commands. (Keys
// and values that are none show in the actions.)
absl::Status CheckComputed(const SampledPrediction& sampled, const PredictedChunk& answer) {
  // Written so that what is not a number is refused too.
  const auto commands = [](const Eigen::MatrixXf& actions) {
    return actions.size() == 0 || (actions.array().abs() <= kWidestCommand).all();
  };
  if (commands(answer.policy_actions) && commands(answer.base_actions) &&
      torch::isfinite(sampled.raw).all().item<bool>() &&
      torch::isfinite(sampled.context.state).all().item<bool>())
    return absl::OkStatus();
  return absl::InternalError(
      absl::StrCat("the policy predicted a value that is not finite, or above ", kWidestCommand,
                   ", with adapter version ", answer.adapter_version,
                   "; check the observation, lower the learning rate or roll the adapter back"));
}

}  // namespace

std::string SessionIdentity(const SessionSpec& spec) {
  return absl::StrJoin({spec.suite, spec.scenario, absl::StrCat(spec.severity), spec.policy,
                        spec.method->method, absl::StrCat(spec.seed)},
                       "/");
}

StreamKey NoiseKey(const SessionSpec& spec, const ChunkKey& key) {
  return PredictionNoiseKey(spec, spec.method->noise_stream, key);
}

torch::Tensor DrawNoise(const StreamKey& key, int64_t horizon, int64_t dim) {
  torch::Tensor noise = torch::empty({1, horizon, dim}, torch::kFloat32);
  RandomStream stream(key);
  float* values = noise.data_ptr<float>();
  for (int64_t i = 0; i < noise.numel(); ++i) values[i] = static_cast<float>(stream.Normal());
  return noise;
}

absl::StatusOr<SampledPrediction> ComputePrediction(Batcher& batcher, PredictionJob job,
                                                    const SessionSpec& spec, const ChunkKey& key,
                                                    PredictedChunk& answer) {
  const FlowPolicy& policy = *job.policy;
  job.with_base = spec.method->track_intent || NeedsBase(spec.method->target);
  try {
    torch::NoGradGuard no_grad;
    job.noise = DrawNoise(NoiseKey(spec, key), policy.horizon(), policy.model_action_dim());
    RS_ASSIGN_OR_RETURN(SampledPrediction sampled, batcher.Predict(job));
    const torch::Tensor& state = sampled.context.state;
    answer.policy_actions = policy.ToEnvironment(sampled.raw, state);
    if (job.with_base) {
      answer.base_actions = sampled.base.defined() ? policy.ToEnvironment(sampled.base, state)
                                                   : answer.policy_actions;
    }
    answer.adapter_version = sampled.adapter == nullptr ? 0 : sampled.adapter->version;
    answer.queue_ms = absl::ToDoubleMilliseconds(sampled.queued);
    answer.compute_ms = absl::ToDoubleMilliseconds(sampled.computed);
    answer.batch_size = sampled.batch_size;
    RS_RETURN_IF_ERROR(CheckComputed(sampled, answer));
    return sampled;
  } catch (const std::exception& error) {
    return ThrownStatus("prediction", error);
  }
}

}  // namespace robostress
