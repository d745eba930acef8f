#include "server/policies/guided_sampler.h"

#include <torch/autograd.h>
#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "common/check.h"

namespace robostress {

torch::Tensor SoftMask(int64_t held, int64_t rows, int64_t horizon) {
  RS_CHECK(0 <= held && held <= rows && rows <= horizon);
  torch::Tensor mask = torch::zeros({horizon}, torch::kFloat32);
  float* weight = mask.data_ptr<float>();
  std::fill_n(weight, held, 1.0f);
  for (int64_t i = held; i < rows; ++i) {
    const double c = static_cast<double>(rows - i) / static_cast<double>(rows - held + 1);
    weight[i] = static_cast<float>(c * (std::exp(c) - 1) / (std::numbers::e - 1));
  }
  return mask;
}

torch::Tensor SampleGuided(const VelocityField& field, const PolicyContext& context,
                           const torch::Tensor& noise, const LoraWeights* lora,
                           const std::vector<float>& times, const Guidance& guidance) {
  RS_CHECK(noise.dim() == 3 && noise.size(0) == 1 && !times.empty() &&
           guidance.rows.sizes() == noise.sizes().slice(1) &&
           guidance.weight.sizes() == noise.sizes().slice(1));
  const torch::Tensor Y = guidance.rows.to(noise.options()).unsqueeze(0);    // [1, K, d]
  const torch::Tensor W = guidance.weight.to(noise.options()).unsqueeze(0);  // [1, K, d]
  const double step = 1.0 / static_cast<double>(times.size());
  torch::Tensor x = noise.detach().clone();
  for (const float time : times) {
    const double u = time;
    torch::Tensor v, g;
    {
      const torch::AutoGradMode with_gradient(true);
      const torch::Tensor from = x.detach().requires_grad_(true);
      v = field.Velocity(context, from, torch::full({1}, u, noise.options()), lora);
      const torch::Tensor a_hat = from - u * v;
      const torch::Tensor error = W * (Y - a_hat.detach());
      g = torch::autograd::grad({a_hat}, {from}, {error})[0];
    }
    const torch::NoGradGuard no_grad;
    // 1 - u is 0 at the first step, or what rounding leaves of it.
    const double full = ((1 - u) * (1 - u) + u * u) / std::max(u * (1 - u), 1e-12);
    const double weight = std::min(guidance.max_weight, full);
    x = x - step * v.detach() + step * weight * g;
  }
  return x;
}

}  // namespace robostress
