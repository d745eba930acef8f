#include "adapter/update_guard.h"

#include <torch/types.h>

#include <cmath>

#include "adapter/compensation.h"
#include "adapter/lora_adapter.h"

namespace robostress {

double GuardLoss(const VelocityField& field, const StreamKey& session, int draws,
                 const std::vector<std::shared_ptr<const TrainingChunk>>& held_out,
                 const LoraWeights& lora) {
  torch::NoGradGuard no_grad;
  const StreamKey key = session.With("guard");
  double sum = 0;
  for (int i = 0; i < draws; ++i) {
    const FlowDraw draw =
        DrawFlow(key, static_cast<uint64_t>(i), field.horizon(), field.model_action_dim());
    for (const auto& chunk : held_out) {  // one by one: memory of a batch of one
      sum +=
          CompensationLoss(field, chunk->context, chunk->target.unsqueeze(0), draw, lora, lora, 0)
              .item<double>();
    }
  }
  return held_out.empty() ? 0 : sum / static_cast<double>(held_out.size()) / draws;
}

GuardVerdict JudgeUpdate(const GuardOptions& options, const VelocityField& field,
                         const StreamKey& session,
                         const std::vector<std::shared_ptr<const TrainingChunk>>& held_out,
                         const LoraWeights& published, const LoraWeights& candidate,
                         const LoraWeights& phi_0) {
  GuardVerdict verdict;
  verdict.candidate_distance = LoraDistance(candidate, phi_0);
  verdict.published_loss = GuardLoss(field, session, options.draws, held_out, published);
  verdict.candidate_loss = GuardLoss(field, session, options.draws, held_out, candidate);
  verdict.accepted =
      std::isfinite(verdict.candidate_distance) &&
      verdict.candidate_loss <= options.max_loss_ratio * verdict.published_loss &&
      (options.max_distance == 0 || verdict.candidate_distance <= options.max_distance);
  return verdict;
}

}  // namespace robostress
