#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "server/policies/openpi/checkpoint.h"
#include "server/policies/openpi/openpi_weights.h"

namespace robostress::openpi {

// Precision of the tensors that a network computes with.
enum class WeightPrecision {
  kAsStored,  // F16 becomes float32, which every operator of a CPU has
  kBf16,      // bfloat16 but for what StaysFloat32 names
  kFloat32,
};
absl::StatusOr<WeightPrecision> ParsePrecision(
    const std::string& name);  // as_stored, bf16, float32

struct LoadOptions {
  WeightPrecision precision = WeightPrecision::kFloat32;
  bool float32_vision = false;  // with kBf16: encoder and projector in float32, as LeRobot does
};

// openpi's selection: patch and position embeddings, the norms of both experts (adaptive dense
// layers included) and what stands outside of paligemma_with_expert.
bool StaysFloat32(const std::string& name, const LoadOptions& options);

// A network whose tensors view the mapping where the stored dtype is the wanted one (the tensors
// keep it alive; they are read-only memory, so writing in place faults: clone before training) and
// are converted one by one, block by block, otherwise; converted pages are given back at once.
// Every value is checked to be finite; the error names file, tensor, index and value.
absl::StatusOr<OpenpiModel> LoadCheckpoint(const Checkpoint& checkpoint,
                                           const LoadOptions& options = {});

}  // namespace robostress::openpi
