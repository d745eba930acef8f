#pragma once

#include <torch/types.h>

#include <vector>

#include "server/policies/openpi/linear.h"

namespace robostress::openpi {

struct LayerNorm {
  torch::Tensor weight, bias;  // [vision_width]
};

// One pre-norm block: x += out(attention(norm1(x))); x += fc2(gelu_tanh(fc1(norm2(x)))).
struct SiglipLayer {
  LayerNorm norm1;
  Linear q, k, v, out;
  LayerNorm norm2;
  Linear fc1, fc2;
};

// SigLIP's image encoder as PaliGemma uses it: no class token, no pooling head.
struct Siglip {
  torch::Tensor patch_weight;  // [vision_width, 3, patch, patch], stride patch
  torch::Tensor patch_bias;    // [vision_width]
  torch::Tensor position;      // [patches, vision_width], learned
  std::vector<SiglipLayer> layers;
  LayerNorm post_norm;
};

// What the encoder computes on its way.
struct SiglipPass {
  torch::Tensor patch_pos;  // [B, patches, vision_width] patch plus position embedding
  torch::Tensor features;   // [B, patches, vision_width] after post_norm
};

// images [B, 3, s, s] in [-1, 1]; patches in row-major order.
SiglipPass RunSiglip(const Siglip& siglip, int64_t heads, const torch::Tensor& images);

}  // namespace robostress::openpi
