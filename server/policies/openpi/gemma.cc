#include "server/policies/openpi/gemma.h"

#include <torch/types.h>

#include <cmath>

#include "server/policies/openpi/cached_attention.h"
#include "server/policies/openpi/masks.h"

namespace robostress::openpi {
namespace {

constexpr double kRmsEpsilon = 1e-6;
constexpr double kRopeBase = 10000;

// y [B, T, w]; gate [B, 1, w], undefined for a plain norm.
struct Normed {
  torch::Tensor y, gate;
};

Normed RmsNorm(const GemmaNorm& norm, const torch::Tensor& x, const torch::Tensor& cond) {
  const torch::Tensor wide = x.to(torch::kFloat32);
  const torch::Tensor unit =
      wide * at::rsqrt(wide.square().mean(-1, /*keepdim=*/true) + kRmsEpsilon);
  if (!norm.dense.weight.defined())
    return {(unit * (1 + norm.weight.to(torch::kFloat32))).to(x.dtype()), {}};
  const auto modulation =
      Apply(norm.dense, cond).to(torch::kFloat32).unsqueeze(1).chunk(3, -1);  // [B, 1, w] each
  const torch::Tensor y = unit * (1 + modulation[0]) + modulation[1];
  return {y.to(x.dtype()), modulation[2].to(x.dtype())};
}

// The residual stream has the type of the expert's products, as in openpi.
torch::Tensor ToStream(const GemmaStack& stack, const torch::Tensor& embeddings) {
  return stack.layers.empty() ? embeddings : embeddings.to(stack.layers[0].q.weight.dtype());
}

torch::Tensor Residual(const torch::Tensor& x, const torch::Tensor& branch,
                       const torch::Tensor& gate) {
  return gate.defined() ? x + gate * branch : x + branch;
}

// cos and sin of position * base^(-2 j / h) in float32, [B, 1, T, h / 2]. The pair (j, j + h / 2)
// turns by the j-th angle.
struct Rotation {
  torch::Tensor cos, sin;
};

Rotation MakeRotation(const torch::Tensor& positions, int64_t head_dim) {
  const torch::Tensor exponent =
      at::arange(0, head_dim, 2, positions.options().dtype(torch::kFloat32)) /
      static_cast<double>(head_dim);
  const torch::Tensor frequency = 1.0 / at::pow(kRopeBase, exponent);  // [h / 2]
  const torch::Tensor angle = positions.to(torch::kFloat32).unsqueeze(-1) * frequency;
  return {angle.cos().unsqueeze(1), angle.sin().unsqueeze(1)};
}

// x [B, heads, T, h].
torch::Tensor Rotate(const torch::Tensor& x, const Rotation& rotation) {
  const auto half = x.to(torch::kFloat32).chunk(2, -1);
  return at::cat({half[0] * rotation.cos - half[1] * rotation.sin,
                  half[1] * rotation.cos + half[0] * rotation.sin},
                 -1)
      .to(x.dtype());
}

// What a layer brings to attention: q [B, heads, T, h]; k, v [B, kv_heads, T, h].
struct Projected {
  torch::Tensor q, k, v;
  torch::Tensor gate;  // of the residual that follows
};

Projected Project(const GemmaLayer& layer, const AttentionShape& shape, const torch::Tensor& x,
                  const torch::Tensor& cond, const Rotation& rotation) {
  const Normed normed = RmsNorm(layer.input_norm, x, cond);
  const auto split = [&](const Linear& projection, int64_t heads) {
    return Apply(projection, normed.y)
        .view({x.size(0), x.size(1), heads, shape.head_dim})
        .transpose(1, 2);
  };
  return {Rotate(split(layer.q, shape.heads), rotation),
          Rotate(split(layer.k, shape.kv_heads), rotation), split(layer.v, shape.kv_heads),
          normed.gate};
}

// softmax(q k^T / sqrt(h) + mask) v; query head i reads key head i / (heads / kv_heads).
// mask [B, 1, T, S] additive -> [B, T, heads h].
torch::Tensor Attend(const torch::Tensor& q, const torch::Tensor& k, const torch::Tensor& v,
                     const torch::Tensor& mask) {
  const int64_t batch = q.size(0), heads = q.size(1), queries = q.size(2), head_dim = q.size(3);
  const int64_t kv_heads = k.size(1), group = heads / kv_heads, keys = k.size(2);
  const torch::Tensor grouped = q.reshape({batch, kv_heads, group * queries, head_dim});
  const torch::Tensor logits =
      at::matmul(grouped, k.transpose(2, 3)) * (1 / std::sqrt(static_cast<double>(head_dim)));
  const torch::Tensor masked = logits.view({batch, heads, queries, keys}) + mask;
  const torch::Tensor weights = at::softmax(masked, -1, torch::kFloat32).to(v.dtype());
  const torch::Tensor mixed = at::matmul(weights.view({batch, kv_heads, group * queries, keys}), v);
  return mixed.view({batch, heads, queries, head_dim})
      .transpose(1, 2)
      .reshape({batch, queries, heads * head_dim});
}

// Of a suffix to a stored prefix and itself.
torch::Tensor AttendOverCache(const Projected& p, const torch::Tensor& prefix_k,
                              const torch::Tensor& prefix_v, const torch::Tensor& mask) {
  if (p.q.is_cpu() && p.q.scalar_type() == torch::kFloat32 && !prefix_k.requires_grad())
    return AttendToStored(p.q, p.k, p.v, prefix_k, prefix_v, mask);
  return Attend(p.q, at::cat({prefix_k, p.k}, 2), at::cat({prefix_v, p.v}, 2), mask);
}

// The rest of a layer after attention: both residuals.
torch::Tensor FinishLayer(const GemmaLayer& layer, const torch::Tensor& x,
                          const torch::Tensor& attended, const torch::Tensor& gate,
                          const torch::Tensor& cond) {
  const torch::Tensor middle = Residual(x, Apply(layer.o, attended), gate);
  const Normed normed = RmsNorm(layer.post_norm, middle, cond);
  const torch::Tensor hidden =
      at::gelu(Apply(layer.gate, normed.y), "tanh") * Apply(layer.up, normed.y);
  return Residual(middle, Apply(layer.down, hidden), normed.gate);
}

}  // namespace

PrefixPass RunPrefix(const GemmaStack& stack, const AttentionShape& shape,
                     const torch::Tensor& embeddings, const torch::Tensor& mask,
                     const torch::Tensor& positions) {
  const Rotation rotation = MakeRotation(positions, shape.head_dim);
  const torch::Tensor additive = AdditiveMask(mask);
  PrefixPass pass;
  torch::Tensor x = ToStream(stack, embeddings);
  for (const GemmaLayer& layer : stack.layers) {
    const Projected p = Project(layer, shape, x, {}, rotation);
    pass.cache.keys.push_back(p.k);
    pass.cache.values.push_back(p.v);
    x = FinishLayer(layer, x, Attend(p.q, p.k, p.v, additive), p.gate, {});
  }
  pass.out_normed = RmsNorm(stack.norm, x, {}).y;
  return pass;
}

torch::Tensor RunSuffix(const GemmaStack& stack, const AttentionShape& shape,
                        const torch::Tensor& embeddings, const torch::Tensor& cond,
                        const torch::Tensor& mask, const torch::Tensor& positions,
                        const KvCache& prefix) {
  const Rotation rotation = MakeRotation(positions, shape.head_dim);
  const torch::Tensor additive = AdditiveMask(mask);
  torch::Tensor x = ToStream(stack, embeddings);
  for (size_t i = 0; i < stack.layers.size(); ++i) {
    const GemmaLayer& layer = stack.layers[i];
    const Projected p = Project(layer, shape, x, cond, rotation);
    const torch::Tensor attended = AttendOverCache(p, prefix.keys[i].to(p.k.dtype()),
                                                   prefix.values[i].to(p.v.dtype()), additive);
    x = FinishLayer(layer, x, attended, p.gate, cond);
  }
  return RmsNorm(stack.norm, x, cond).y;
}

torch::Tensor RunJoint(const GemmaStack& prefix, const GemmaStack& expert,
                       const AttentionShape& shape, const torch::Tensor& prefix_embeddings,
                       const torch::Tensor& suffix_embeddings, const torch::Tensor& cond,
                       const torch::Tensor& mask, const torch::Tensor& positions) {
  const int64_t split = prefix_embeddings.size(1), total = split + suffix_embeddings.size(1);
  const Rotation a_rotation = MakeRotation(positions.narrow(1, 0, split), shape.head_dim);
  const Rotation b_rotation =
      MakeRotation(positions.narrow(1, split, total - split), shape.head_dim);
  const torch::Tensor additive = AdditiveMask(mask);
  torch::Tensor a = ToStream(prefix, prefix_embeddings), b = ToStream(expert, suffix_embeddings);
  for (size_t i = 0; i < prefix.layers.size(); ++i) {
    const Projected pa = Project(prefix.layers[i], shape, a, {}, a_rotation);
    const Projected pb = Project(expert.layers[i], shape, b, cond, b_rotation);
    const torch::Tensor attended =
        Attend(at::cat({pa.q, pb.q}, 2), at::cat({pa.k, pb.k}, 2), at::cat({pa.v, pb.v}, 2),
               additive);  // [B, P + S, heads h]
    a = FinishLayer(prefix.layers[i], a, attended.narrow(1, 0, split), pa.gate, {});
    b = FinishLayer(expert.layers[i], b, attended.narrow(1, split, total - split), pb.gate, cond);
  }
  return RmsNorm(expert.norm, b, cond).y;
}

}  // namespace robostress::openpi
