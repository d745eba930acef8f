#include "server/sessions/prediction.h"

#include <torch/types.h>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/status_macros.h"

namespace robostress {

std::string SessionIdentity(const SessionSpec& spec) {
  return absl::StrJoin({spec.suite, spec.scenario, absl::StrCat(spec.severity), spec.policy,
                        spec.method->method, absl::StrCat(spec.seed)},
                       "/");
}

StreamKey NoiseKey(const SessionSpec& spec, int task, int episode, int chunk) {
  return StreamKey("prediction_noise")
      .With(spec.method->noise_stream)
      .With(spec.seed)
      .With(spec.suite)
      .With(int64_t{task})
      .With(int64_t{episode})
      .With(int64_t{chunk});
}

torch::Tensor DrawNoise(const StreamKey& key, int64_t horizon, int64_t dim) {
  torch::Tensor noise = torch::empty({1, horizon, dim}, torch::kFloat32);
  RandomStream stream(key);
  float* values = noise.data_ptr<float>();
  for (int64_t i = 0; i < noise.numel(); ++i) values[i] = static_cast<float>(stream.Normal());
  return noise;
}

absl::StatusOr<ComputedPrediction> ComputePrediction(Batcher& batcher, PredictionJob job,
                                                     const SessionSpec& spec,
                                                     const Observation& observation, int task,
                                                     int episode, int chunk) {
  const FlowPolicy& policy = *job.policy;
  job.observation = &observation;
  job.with_base = spec.method->track_intent || spec.method->target == TargetReference::kIntent;
  ComputedPrediction result;
  try {
    torch::NoGradGuard no_grad;
    job.noise = DrawNoise(NoiseKey(spec, task, episode, chunk), policy.horizon(),
                          policy.model_action_dim());
    RS_ASSIGN_OR_RETURN(SampledPrediction sampled, batcher.Predict(job));
    result.context = std::move(sampled.context);
    result.raw = std::move(sampled.raw);
    const torch::Tensor& state = result.context.state;
    result.policy_actions = policy.ToEnvironment(result.raw, state);
    if (job.with_base) {
      result.base_actions = sampled.base.defined() ? policy.ToEnvironment(sampled.base, state)
                                                   : result.policy_actions;
    }
    result.adapter_version = sampled.adapter == nullptr ? 0 : sampled.adapter->version;
    result.queue_ms = absl::ToDoubleMilliseconds(sampled.queued);
    result.compute_ms = absl::ToDoubleMilliseconds(sampled.computed);
    result.batch_size = sampled.batch_size;
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("prediction failed: ", error.what()));
  }
  return result;
}

}  // namespace robostress
