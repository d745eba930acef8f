#pragma once

#include <memory>
#include <vector>

#include "adapter/lora.h"
#include "adapter/velocity_field.h"
#include "common/random.h"

// Whether an update's candidate may be published (off in the paper's method).
namespace robostress {

struct TrainingChunk;

struct GuardOptions {
  bool enabled = false;
  double max_loss_ratio = 1;  // loss of the candidate / of the published adapter, above 0
  double max_distance = 0;    // ||phi - phi_0||_2 of the candidate; 0: no bound
  int draws = 4;              // (u, eps) pairs, 1..64
  int chunks = 4;             // buffered chunks that the update does not sample, 1..64
};

struct GuardVerdict {
  bool accepted = true;
  double published_loss = 0, candidate_loss = 0;  // 0 where nothing was held out
  double candidate_distance = 0;                  // ||phi - phi_0||_2
};

// Mean flow-matching loss (paper, Eq. flow-matching, no anchor) of `lora` on `held_out` over draws
// 0 .. draws - 1 of the session's guard set. The set is the same for every adapter and every
// update, so two losses differ by the adapters alone. May throw what Torch throws.
double GuardLoss(const VelocityField& field, const StreamKey& session, int draws,
                 const std::vector<std::shared_ptr<const TrainingChunk>>& held_out,
                 const LoraWeights& lora);

// Accepts the candidate unless its loss exceeds max_loss_ratio x the published adapter's, its
// distance from phi_0 the bound, or one of them is not finite. May throw what Torch throws.
GuardVerdict JudgeUpdate(const GuardOptions& options, const VelocityField& field,
                         const StreamKey& session,
                         const std::vector<std::shared_ptr<const TrainingChunk>>& held_out,
                         const LoraWeights& published, const LoraWeights& candidate,
                         const LoraWeights& phi_0);

}  // namespace robostress
