#include "server/policies/openpi/siglip.h"

#include <torch/types.h>

#include <cmath>

namespace robostress::openpi {
namespace {

constexpr double kEpsilon = 1e-6;

torch::Tensor Normalise(const LayerNorm& norm, const torch::Tensor& x) {
  return at::layer_norm(x, {x.size(-1)}, norm.weight.to(x.dtype()), norm.bias.to(x.dtype()),
                        kEpsilon);
}

// softmax(q k^T / sqrt(h)) v over all patches. x [B, N, w] -> [B, N, w].
torch::Tensor SelfAttention(const SiglipLayer& layer, int64_t heads, const torch::Tensor& x) {
  const int64_t batch = x.size(0), patches = x.size(1), width = x.size(2), head = width / heads;
  const auto split = [&](const Linear& projection) {  // [B, heads, N, h]
    return Apply(projection, x).view({batch, patches, heads, head}).transpose(1, 2);
  };
  const torch::Tensor logits = at::matmul(split(layer.q), split(layer.k).transpose(2, 3)) *
                               (1 / std::sqrt(static_cast<double>(head)));
  const torch::Tensor weights = at::softmax(logits, -1, torch::kFloat32).to(x.dtype());
  const torch::Tensor mixed = at::matmul(weights, split(layer.v));  // [B, heads, N, h]
  return Apply(layer.out, mixed.transpose(1, 2).reshape({batch, patches, width}));
}

torch::Tensor RunLayer(const SiglipLayer& layer, int64_t heads, torch::Tensor x) {
  x = x + SelfAttention(layer, heads, Normalise(layer.norm1, x));
  const torch::Tensor hidden = at::gelu(Apply(layer.fc1, Normalise(layer.norm2, x)), "tanh");
  return x + Apply(layer.fc2, hidden);
}

}  // namespace

SiglipPass RunSiglip(const Siglip& siglip, int64_t heads, const torch::Tensor& images) {
  const int64_t patch = siglip.patch_weight.size(-1);
  const torch::Tensor grid = at::conv2d(images.to(siglip.patch_weight.dtype()), siglip.patch_weight,
                                        siglip.patch_bias, /*stride=*/patch);
  SiglipPass pass;
  pass.patch_pos = grid.flatten(2).transpose(1, 2) + siglip.position;  // [B, patches, w]
  torch::Tensor x = pass.patch_pos;
  if (!siglip.layers.empty()) x = x.to(siglip.layers[0].q.weight.dtype());
  for (const SiglipLayer& layer : siglip.layers) x = RunLayer(layer, heads, x);
  pass.features = Normalise(siglip.post_norm, x);
  return pass;
}

}  // namespace robostress::openpi
