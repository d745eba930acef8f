#include "server/policies/openpi/layer_ops.h"

#include <ATen/Parallel.h>
#include <torch/types.h>

#include <cmath>

#include "server/policies/kernels/fused_kernels.h"

namespace robostress::openpi {
namespace {

constexpr double kEpsilon = 1e-6;
constexpr double kRopeBase = 10000;
constexpr int64_t kGrain = 1 << 15;  // elements worth a thread of their own

bool RunsFused(const torch::Tensor& x) {
  return x.is_cpu() && x.scalar_type() == torch::kFloat32 && x.is_contiguous();
}

// f(first row, number of rows) over all rows of `width` elements, on LibTorch's threads.
template <class F>
void ForRows(int64_t rows, int64_t width, F&& f) {
  at::parallel_for(0, rows, std::max<int64_t>(1, kGrain / width),
                   [&](int64_t begin, int64_t end) { f(begin, end - begin); });
}

float* At(const torch::Tensor& x, int64_t row, int64_t width) {
  return x.data_ptr<float>() + row * width;
}

torch::Tensor NormaliseFused(torch::Tensor& x, const torch::Tensor& branch,
                             const Modulation& modulation) {
  const int64_t width = x.size(1);
  const torch::Tensor y = at::empty_like(x), inverse_rms = at::empty({x.size(0)}, x.options());
  ForRows(x.size(0), width, [&](int64_t first, int64_t rows) {
    float* row = At(x, first, width);
    BestFusedKernels().add_rms_norm(row, branch.defined() ? At(branch, first, width) : nullptr,
                                    modulation.scale.data_ptr<float>(), rows, width,
                                    branch.defined() ? row : nullptr, At(y, first, width),
                                    inverse_rms.data_ptr<float>() + first);
  });
  return modulation.shift.defined() ? y.add_(modulation.shift) : y;
}

// [B T, heads h] -> [B kv_heads, T heads / kv_heads, h].
torch::Tensor GroupHeads(const torch::Tensor& x, int64_t batch, int64_t kv_heads,
                         int64_t head_dim) {
  const int64_t tokens = x.size(0) / batch, group = x.size(1) / (kv_heads * head_dim);
  return x.reshape({batch, tokens, kv_heads, group, head_dim})
      .transpose(1, 2)
      .reshape({batch * kv_heads, tokens * group, head_dim});
}

// x [B T, heads h], rotated in float32 and multiplied by `scale`.
torch::Tensor Rotate(const torch::Tensor& x, const Rotary& rotary, double scale) {
  const int64_t half = rotary.cos.size(1);
  const auto parts = x.to(torch::kFloat32).reshape({x.size(0), -1, 2, half}).unbind(2);
  const torch::Tensor cos = rotary.cos.unsqueeze(1) * scale, sin = rotary.sin.unsqueeze(1) * scale;
  return at::stack({parts[0] * cos - parts[1] * sin, parts[1] * cos + parts[0] * sin}, 2)
      .view(x.sizes())
      .to(x.scalar_type());
}

// In place softmax(scores + mask) for scores [B kv_heads, T group, S].
torch::Tensor SoftmaxFused(torch::Tensor scores, const torch::Tensor& mask, int64_t queries) {
  const int64_t items = scores.size(0), rows = scores.size(1), keys = scores.size(2);
  const torch::Tensor bias = mask.defined() ? mask.contiguous() : at::zeros({1, 1, keys});
  const int64_t per_block = items / bias.size(0), group = rows / queries;
  for (int64_t item = 0; item < items; ++item) {
    const float* block = bias.data_ptr<float>() + item / per_block * bias.size(1) * keys;
    ForRows(queries, group * keys, [&](int64_t first, int64_t count) {
      const float* row = block + (bias.size(1) == 1 ? 0 : first * keys);
      BestFusedKernels().softmax_bias(At(scores, item * rows + first * group, keys), row, 1,
                                      count * group, keys, group, bias.size(1), 1);
    });
  }
  return scores;
}

torch::Tensor Softmax(const torch::Tensor& scores, const torch::Tensor& mask, int64_t batch,
                      int64_t queries) {
  if (RunsFused(scores)) return SoftmaxFused(scores, mask, queries);
  if (!mask.defined()) return at::softmax(scores, -1, torch::kFloat32).to(scores.scalar_type());
  const torch::Tensor grouped =
      scores.to(torch::kFloat32)
          .view({batch, scores.size(0) / batch, queries, scores.size(1) / queries, scores.size(2)});
  return at::softmax(grouped + mask.unsqueeze(1).unsqueeze(3), -1)
      .to(scores.scalar_type())
      .view_as(scores);
}

}  // namespace

torch::Tensor AddAndNormalise(torch::Tensor& x, const torch::Tensor& branch,
                              const Modulation& modulation) {
  if (RunsFused(x)) return NormaliseFused(x, branch, modulation);
  if (branch.defined()) x.add_(branch);
  const torch::Tensor wide = x.to(torch::kFloat32);
  torch::Tensor y = wide * at::rsqrt(wide.square().mean(-1, /*keepdim=*/true) + kEpsilon) *
                    (1 + modulation.scale);
  if (modulation.shift.defined()) y.add_(modulation.shift);
  return y.to(x.scalar_type());
}

torch::Tensor GeGlu(const torch::Tensor& gate_up) {
  const int64_t width = gate_up.size(1) / 2;
  if (!RunsFused(gate_up)) {
    const auto parts = gate_up.chunk(2, 1);
    return at::gelu(parts[0], "tanh").mul_(parts[1]);
  }
  const torch::Tensor y = at::empty({gate_up.size(0), width}, gate_up.options());
  ForRows(gate_up.size(0), 2 * width, [&](int64_t first, int64_t rows) {
    BestFusedKernels().geglu(At(gate_up, first, 2 * width), rows, width, At(y, first, width));
  });
  return y;
}

void Gelu(torch::Tensor& x) {
  if (!RunsFused(x)) {
    x = at::gelu(x, "tanh");
    return;
  }
  const int64_t width = x.size(-1);
  ForRows(x.numel() / width, width, [&](int64_t first, int64_t rows) {
    BestFusedKernels().gelu(At(x, first, width), rows * width);
  });
}

Rotary MakeRotary(const torch::Tensor& positions, int64_t head_dim) {
  const torch::Tensor exponent =
      at::arange(0, head_dim, 2, positions.options().dtype(torch::kFloat32)) /
      static_cast<double>(head_dim);
  const torch::Tensor frequency = 1.0 / at::pow(kRopeBase, exponent);  // [h / 2]
  const torch::Tensor angle = positions.to(torch::kFloat32).unsqueeze(-1) * frequency;
  return {angle.cos(), angle.sin(), at::arange(positions.size(0), positions.options())};
}

Heads SplitHeads(const torch::Tensor& qkv, int64_t batch, const AttentionShape& shape,
                 int64_t heads, const Rotary* rotary) {
  const int64_t h = shape.head_dim, kv = shape.kv_heads, rows = qkv.size(0), tokens = rows / batch;
  const double scale = 1 / std::sqrt(static_cast<double>(h));
  const auto columns = [&](int64_t first, int64_t count) {
    return qkv.narrow(1, first * h, count * h);
  };
  if (rotary == nullptr || kv != 1 || !RunsFused(qkv)) {
    const auto turn = [&](const torch::Tensor& x, double factor) {
      return rotary != nullptr ? Rotate(x, *rotary, factor) : factor == 1 ? x : x * factor;
    };
    Heads split;
    if (heads > 0) split.q = GroupHeads(turn(columns(0, heads), scale), batch, kv, h);
    split.k = GroupHeads(turn(columns(heads, kv), 1), batch, kv, h);
    split.v = GroupHeads(columns(heads + kv, kv), batch, kv, h);
    return split;
  }
  Heads split = {at::empty({batch, tokens * heads, h}, qkv.options()),
                 at::empty({batch, tokens, h}, qkv.options()),
                 at::empty({batch, tokens, h}, qkv.options())};
  ForRows(rows, qkv.size(1), [&](int64_t first, int64_t count) {
    BestFusedKernels().split_rope(
        At(qkv, first, qkv.size(1)), rotary->cos.data_ptr<float>(), rotary->sin.data_ptr<float>(),
        rotary->rows.data_ptr<int64_t>() + first, static_cast<float>(scale), count, heads, h,
        /*inverse=*/false, At(split.q, first, heads * h), At(split.k, first, h),
        At(split.v, first, h));
  });
  return split;
}

torch::Tensor Attend(const torch::Tensor& q, const torch::Tensor& k, const torch::Tensor& v,
                     const torch::Tensor& mask, int64_t batch, const AttentionShape& shape) {
  const int64_t group = shape.heads / shape.kv_heads, queries = q.size(1) / group;
  const torch::Tensor weights = Softmax(at::bmm(q, k.transpose(1, 2)), mask, batch, queries);
  return at::bmm(weights, v)  // [B kv_heads, T group, h]
      .view({batch, shape.kv_heads, queries, group * shape.head_dim})
      .transpose(1, 2)
      .reshape({batch * queries, shape.heads * shape.head_dim});
}

}  // namespace robostress::openpi
