#include "adapter/compensation.h"

#include <torch/types.h>

#include "common/check.h"

namespace robostress {

FlowDraw DrawFlow(const StreamKey& session, uint64_t update, int64_t horizon, int64_t action_dim) {
  const StreamKey key = session.With("update").With(static_cast<int64_t>(update));
  FlowDraw draw;
  draw.u = RandomStream(key.With("u")).Uniform();
  draw.eps = torch::empty({horizon, action_dim}, torch::kFloat32);
  RandomStream stream(key.With("eps"));
  float* values = draw.eps.data_ptr<float>();
  for (int64_t i = 0; i < draw.eps.numel(); ++i) values[i] = static_cast<float>(stream.Normal());
  return draw;
}

torch::Tensor TargetChunk(const torch::Tensor& raw, int64_t first_step,
                          const torch::Tensor& corrected) {
  RS_CHECK(raw.dim() == 2 && corrected.dim() == 2);
  const int64_t arm = corrected.size(1) - 1;
  RS_CHECK(first_step >= 0 && first_step + corrected.size(0) <= raw.size(0) && arm <= raw.size(1));
  torch::NoGradGuard no_grad;
  torch::Tensor target = raw.clone();
  target.narrow(0, first_step, corrected.size(0))
      .narrow(1, 0, arm)
      .copy_(corrected.narrow(1, 0, arm));
  return target;
}

torch::Tensor CompensationLoss(const VelocityField& field, const PolicyContext& context,
                               const torch::Tensor& targets, const FlowDraw& draw,
                               const LoraWeights& phi, const LoraWeights& phi_0,
                               double anchor_weight) {
  const int64_t batch = targets.size(0);
  const torch::Tensor eps = draw.eps.unsqueeze(0);                          // [1, K, d]
  const torch::Tensor x_u = draw.u * eps + (1 - draw.u) * targets;          // [B, K, d]
  const torch::Tensor u = torch::full({batch}, draw.u, targets.options());  // [B]
  const torch::Tensor v = field.Velocity(context, x_u, u, &phi);            // [B, K, d]
  torch::Tensor loss = (v - (eps - targets)).square().mean();
  if (anchor_weight != 0) {
    const std::vector<torch::Tensor> p = Parameters(phi), p_0 = Parameters(phi_0);
    torch::Tensor anchor = torch::zeros({}, targets.options());
    for (size_t i = 0; i < p.size(); ++i) anchor = anchor + (p[i] - p_0[i]).square().sum();
    loss = loss + anchor_weight * anchor;
  }
  return loss;
}

}  // namespace robostress
