#include "server/training/flow_objective.h"

#include <torch/types.h>

namespace robostress {

using torch::Tensor;

FlowDraw DrawFlow(int64_t rows, int64_t draws, const NanoConfig& config, uint64_t seed) {
  auto generator = at::make_generator<at::CPUGeneratorImpl>(seed);
  FlowDraw draw;
  draw.noise = torch::randn({rows * draws, config.horizon, config.model_action_dim}, generator);
  const Tensor uniform =
      (torch::rand({rows, draws}, generator) + torch::arange(draws)) / static_cast<double>(draws);
  draw.t = (uniform.pow(1.0 / 1.5) * 0.999 + 0.001).flatten();
  return draw;
}

Tensor FlowLoss(const NanoNetwork& network, const PolicyContext& context, const Tensor& actions,
                const FlowDraw& draw, const Tensor& step_weights) {
  const int64_t draws = draw.t.size(0) / actions.size(0);
  const Tensor a = actions.repeat_interleave(draws, 0);  // [rows draws, K, d]
  const Tensor t = draw.t.view({-1, 1, 1});
  const Tensor x = t * draw.noise + (1.0 - t) * a;
  const Tensor v = network.Velocity(context, x, draw.t, nullptr);
  return ((v - (draw.noise - a)).square() * step_weights).mean();
}

}  // namespace robostress
