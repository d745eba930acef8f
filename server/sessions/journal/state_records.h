#pragma once

#include <torch/types.h>

#include <memory>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "adapter/lora_adapter.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/prediction.h"

// Between what a session holds and its records on disk. Exact: every bit of a tensor comes back.
// FromRecord trusts nothing; an error is DATA_LOSS and names field and value.
namespace robostress {

v1::StateTensor ToRecord(const torch::Tensor& tensor);
// `field` names the tensor in errors. Floating-point values must be finite.
absl::StatusOr<torch::Tensor> FromRecord(const char* field, const v1::StateTensor& record);

v1::UpdateGuard ToRecord(const GuardOptions& guard);
// Zeros stand for defaults (policy.proto); INVALID_ARGUMENT out of range.
absl::StatusOr<GuardOptions> FromRecord(const v1::UpdateGuard& record);

// `with_views` false: without the images of its observation.
v1::StatePrediction ToRecord(const Prediction& prediction, bool with_views = true);
// Without `prefix`, which the caller makes of the observation.
absl::StatusOr<Prediction> FromRecord(const v1::StatePrediction& record);

// `context`: of an imported chunk, which has no observation; else null.
v1::StateTrainingChunk ToRecord(const BufferedChunk& chunk, const PolicyContext* context);
struct StoredChunk {
  torch::Tensor target;
  std::shared_ptr<const Observation> observation;  // or
  PolicyContext context;
};
absl::StatusOr<StoredChunk> FromRecord(const v1::StateTrainingChunk& record);

v1::StateVersion ToRecord(const PublishedVersion& version);
absl::StatusOr<PublishedVersion> FromRecord(const v1::StateVersion& record);

}  // namespace robostress
