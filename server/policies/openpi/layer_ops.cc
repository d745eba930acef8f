#include "server/policies/openpi/layer_ops.h"

#include <ATen/Parallel.h>
#include <torch/types.h>

#include <cmath>

#include "server/policies/kernels/fused_kernels.h"
#ifdef ROBOSTRESS_GPU_KERNELS
#include <c10/cuda/CUDAException.h>
#include <c10/cuda/CUDAStream.h>

#include "server/policies/openpi/gpu_kernels.h"
#endif

namespace robostress::openpi {
namespace {

constexpr double kEpsilon = 1e-6;
constexpr double kRopeBase = 10000;
constexpr int64_t kGrain = 1 << 15;  // elements worth a thread of their own

bool RunsFused(const torch::Tensor& x) {
  return x.is_cpu() && x.scalar_type() == torch::kFloat32 && x.is_contiguous();
}

#ifdef ROBOSTRESS_GPU_KERNELS
bool RunsOnGpu(const torch::Tensor& x) {
  return x.is_cuda() && x.is_contiguous() && !(at::GradMode::is_enabled() && x.requires_grad()) &&
         (x.scalar_type() == torch::kFloat32 || x.scalar_type() == torch::kBFloat16);
}

// kernel(element type of x, stream), on the stream that LibTorch uses.
template <class F>
void Launch(const torch::Tensor& x, F&& kernel) {
  kernel(x.scalar_type() == torch::kFloat32 ? gpu::Element::kFloat32 : gpu::Element::kBfloat16,
         static_cast<void*>(c10::cuda::getCurrentCUDAStream(x.device().index()).stream()));
  C10_CUDA_KERNEL_LAUNCH_CHECK();
}

template <class T = void>
T* PointerOrNull(const torch::Tensor& x) {
  return x.defined() ? static_cast<T*>(x.data_ptr()) : nullptr;
}

torch::Tensor NormaliseOnGpu(torch::Tensor& x, const torch::Tensor& branch,
                             const torch::Tensor& gate, const Modulation& modulation) {
  torch::Tensor y = at::empty_like(x);
  Launch(x, [&](gpu::Element type, void* stream) {
    gpu::AddRmsNorm(type, x.data_ptr(), PointerOrNull(branch), PointerOrNull(gate),
                    modulation.scale.data_ptr<float>(), PointerOrNull<float>(modulation.shift),
                    x.size(0), x.size(1), y.data_ptr(), stream);
  });
  return y;
}

Heads SplitHeadsOnGpu(const torch::Tensor& qkv, int64_t batch, const AttentionShape& shape,
                      int64_t heads, const Rotary* rotary) {
  const int64_t h = shape.head_dim, kv = shape.kv_heads, tokens = qkv.size(0) / batch;
  Heads split = {at::empty({batch * kv, tokens * (heads / kv), h}, qkv.options()),
                 at::empty({batch * kv, tokens, h}, qkv.options()),
                 at::empty({batch * kv, tokens, h}, qkv.options())};
  Launch(qkv, [&](gpu::Element type, void* stream) {
    gpu::SplitHeads(type, qkv.data_ptr(), rotary ? rotary->cos.data_ptr<float>() : nullptr,
                    rotary ? rotary->sin.data_ptr<float>() : nullptr,
                    1 / std::sqrt(static_cast<float>(h)), batch, tokens, heads, kv, h,
                    split.q.data_ptr(), split.k.data_ptr(), split.v.data_ptr(), stream);
  });
  return split;
}

// In place.
torch::Tensor SoftmaxOnGpu(torch::Tensor scores, const torch::Tensor& mask, int64_t queries) {
  const int64_t items = scores.size(0), keys = scores.size(2);
  const torch::Tensor dense = mask.defined() ? mask.contiguous() : mask;
  gpu::MaskShape shape;
  if (dense.defined()) shape = {items / dense.size(0), dense.size(1)};
  Launch(scores, [&](gpu::Element type, void* stream) {
    gpu::Softmax(type, scores.data_ptr(), PointerOrNull<float>(dense), shape, items, queries,
                 scores.size(1) / queries, keys, stream);
  });
  return scores;
}

torch::Tensor GeGluOnGpu(const torch::Tensor& gate_up) {
  torch::Tensor y = at::empty({gate_up.size(0), gate_up.size(1) / 2}, gate_up.options());
  Launch(gate_up, [&](gpu::Element type, void* stream) {
    gpu::GeGlu(type, gate_up.data_ptr(), y.size(0), y.size(1), y.data_ptr(), stream);
  });
  return y;
}
#endif

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
#ifdef ROBOSTRESS_GPU_KERNELS
  if (RunsOnGpu(scores)) return SoftmaxOnGpu(scores, mask, queries);
#endif
  if (!mask.defined()) return at::softmax(scores, -1, torch::kFloat32).to(scores.scalar_type());
  const torch::Tensor grouped =
      scores.to(torch::kFloat32)
          .view({batch, scores.size(0) / batch, queries, scores.size(1) / queries, scores.size(2)});
  return at::softmax(grouped + mask.unsqueeze(1).unsqueeze(3), -1)
      .to(scores.scalar_type())
      .view_as(scores);
}

}  // namespace

torch::Tensor AddAndNormalise(torch::Tensor& x, torch::Tensor branch, const torch::Tensor& gate,
                              const Modulation& modulation) {
#ifdef ROBOSTRESS_GPU_KERNELS
  if (RunsOnGpu(x)) return NormaliseOnGpu(x, branch, gate, modulation);
#endif
  if (branch.defined() && gate.defined()) branch.mul_(gate);
  if (RunsFused(x)) return NormaliseFused(x, branch, modulation);
  if (branch.defined()) x.add_(branch);
  const torch::Tensor wide = x.to(torch::kFloat32);
  torch::Tensor y = wide * at::rsqrt(wide.square().mean(-1, /*keepdim=*/true) + kEpsilon) *
                    (1 + modulation.scale);
  if (modulation.shift.defined()) y.add_(modulation.shift);
  return y.to(x.scalar_type());
}

torch::Tensor GeGlu(const torch::Tensor& gate_up) {
#ifdef ROBOSTRESS_GPU_KERNELS
  if (RunsOnGpu(gate_up)) return GeGluOnGpu(gate_up);
#endif
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
#ifdef ROBOSTRESS_GPU_KERNELS
  if (RunsOnGpu(qkv)) return SplitHeadsOnGpu(qkv, batch, shape, heads, rotary);
#endif
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
