#pragma once

#include <torch/types.h>

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/types/span.h"
#include "common/random.h"
#include "common/safetensors.h"
#include "server/policies/nano/nano_weights.h"

namespace robostress {

// Frames as the network takes them; B rows.
struct DemoBatch {
  std::vector<torch::Tensor> images;  // per camera [B, 3, s, s] in [-1, 1], channels last in memory
  torch::Tensor words;                // [B, longest instruction of the batch]
  torch::Tensor state;                // [B, state_dim] normalised
  torch::Tensor actions;              // [B, K, d] normalised, padding channels 0
  torch::Tensor aux;                  // [B, aux_dim] normalised; 0 where a shard has none
};

// Random changes of a frame; zeros: none.
struct Augmentation {
  int shift_px = 0;
  double colour_jitter = 0;
  double state_noise = 0;
};

// Demonstration shards (one safetensors file per task and batch of episodes), memory-mapped: frames
// are read when they are drawn, so the machine's page cache is the only copy. Immutable; Fill may
// run on several threads.
class Demonstrations {
 public:
  // Every *.safetensors below the directories, in the order of their names; the error names file,
  // tensor and value.
  static absl::StatusOr<Demonstrations> Open(const std::vector<std::string>& directories,
                                             const NanoConfig& config, double validation_share);

  // Frame numbers for training, and held-out ones (whole episodes).
  const std::vector<int64_t>& training() const { return training_; }
  const std::vector<int64_t>& validation() const { return validation_; }
  int64_t episodes() const { return episodes_; }
  // A shard without auxiliary targets, or empty: those train with aux_weight 0 only.
  const std::string& without_aux() const { return without_aux_; }

  // Words and z-scores of the training frames. Dimensions that hardly vary get a floor of the
  // deviation, so that normalising does not blow up their noise.
  absl::StatusOr<Vocabulary> CollectWords(Vocabulary start) const;
  void MeasureNormalisation(NanoModel& model) const;

  // Row i of the batch is frames[i]; `random` feeds the augmentation. The model gives words and
  // normalisation.
  absl::StatusOr<DemoBatch> Fill(absl::Span<const int64_t> frames, const NanoModel& model,
                                 const Augmentation& augmentation, RandomStream& random) const;
  // Asks the kernel to read these frames' images ahead, so that a Fill soon after does not wait for
  // the disk. Returns at once.
  void WillNeed(absl::Span<const int64_t> frames) const;

 private:
  struct Shard {
    SafetensorsFile file;
    std::string instruction;
    int64_t first = 0, frames = 0;
    const uint8_t* images = nullptr;  // [frames, views, s, s, 3]
    const float* state = nullptr;
    const float* actions = nullptr;  // [frames, K, action_dim]
    const float* aux = nullptr;      // may be absent
  };
  explicit Demonstrations(const NanoConfig& config) : config_(config) {}
  absl::Status AddShard(const std::string& path, double validation_share);
  const Shard& ShardOf(int64_t frame) const;
  // Step `step` of a shard's frame as the network sees it, before normalising [action_dim].
  std::vector<float> Action(const Shard& shard, int64_t frame, int step) const;

  NanoConfig config_;
  std::vector<Shard> shards_;
  std::vector<int64_t> training_, validation_;
  int64_t frames_ = 0, episodes_ = 0;
  std::string without_aux_;
};

}  // namespace robostress
