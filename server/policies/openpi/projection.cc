#include "server/policies/openpi/projection.h"

#include <ATen/Parallel.h>
#include <torch/types.h>

#include <algorithm>

#include "adapter/lora.h"
#include "common/check.h"
#include "server/policies/kernels/fused_kernels.h"

namespace robostress::openpi {
namespace {

constexpr int64_t kTileFloats = 1 << 19;  // 2 MiB: a tile is still in the cache when multiplied
constexpr int64_t kTileRows = 128;        // fewer outputs per product would waste its packing
constexpr int64_t kPackedRows = 128;      // for more, BLAS is as fast
constexpr int64_t kThreadRows = 20;

// y = x W^T with W in bfloat16 and the rest in float32.
void MultiplyWidened(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& y) {
  const int64_t out = weight.size(0), in = weight.size(1);
  const int64_t rows = std::min(out, std::max(kTileRows, kTileFloats / in));
  const torch::Tensor tile = at::empty({rows, in}, x.options());
  const auto* bits = reinterpret_cast<const uint16_t*>(weight.data_ptr<at::BFloat16>());
  for (int64_t first = 0; first < out; first += rows) {
    const int64_t count = std::min(rows, out - first);
    at::parallel_for(0, count, 16, [&](int64_t begin, int64_t end) {
      BestFusedKernels().widen_bf16(bits + (first + begin) * in, (end - begin) * in,
                                    tile.data_ptr<float>() + begin * in);
    });
    torch::Tensor part = y.narrow(1, first, count);
    at::mm_out(part, x, tile.narrow(0, 0, count).t());
  }
}

// y = x W^T + b; x [rows, in], y [rows, out], possibly columns of a wider matrix.
void Multiply(const torch::Tensor& x, const torch::Tensor& weight, const torch::Tensor& bias,
              torch::Tensor y) {
  if (weight.scalar_type() != x.scalar_type()) {
    MultiplyWidened(x, weight, y);
    if (bias.defined()) y.add_(bias);
  } else if (x.scalar_type() != torch::kFloat32 && !y.is_contiguous()) {
    y.copy_(at::linear(x, weight, bias));  // oneDNN's products do not write into columns
  } else if (bias.defined()) {
    at::addmm_out(y, bias, x, weight.t());
  } else {
    at::mm_out(y, x, weight.t());
  }
}

// y = x W^T + b by the packed copy of W; y contiguous. A row's result depends on that row alone.
void MultiplyPacked(const torch::Tensor& x, const Projection& projection, torch::Tensor y) {
  const int64_t in = projection.in, out = projection.out;
  const torch::Tensor rows = x.contiguous();
  at::parallel_for(0, rows.size(0), kThreadRows, [&](int64_t begin, int64_t end) {
    BestFusedKernels().linear(rows.data_ptr<float>() + begin * in, end - begin, in,
                              projection.panels.data_ptr<float>(), out,
                              y.data_ptr<float>() + begin * out);
  });
  if (projection.bias.defined()) y.add_(projection.bias);
}

// y += scale B A x for the pair of a target, in either of its forms (adapter/lora.h).
void AddAdapter(const torch::Tensor& x, const torch::Tensor& A, const torch::Tensor& B,
                double scale, const torch::Tensor& y) {
  y.add_(LoraDelta(x, A.to(x.scalar_type()), B.to(x.scalar_type())), scale);
}

}  // namespace

Projection Projection::Join(std::vector<Linear> parts, int64_t limit_bytes) {
  Projection joined;
  std::vector<torch::Tensor> weights, biases;
  int64_t bytes = 0;
  for (const Linear& part : parts) {
    RS_CHECK(!part.lora_rows);  // adapters of rows are given to each prediction
    weights.push_back(part.weight);
    if (part.bias.defined()) biases.push_back(part.bias);
    bytes += static_cast<int64_t>(part.weight.nbytes());
    joined.out += part.weight.size(0);
  }
  joined.in = weights.front().size(1);
  if (parts.size() == 1) {
    joined.weight = weights.front();
    joined.bias = parts.front().bias;
  } else if (bytes <= limit_bytes) {
    joined.weight = at::cat(weights, 0);
    if (!biases.empty()) joined.bias = at::cat(biases, 0);
  }
  joined.parts = std::move(parts);
  int64_t first = 0;
  for (Linear& part : joined.parts) {
    const int64_t out = part.weight.size(0);
    if (joined.weight.defined()) part.weight = joined.weight.narrow(0, first, out);
    first += out;
  }
  return joined;
}

Projection Projection::Packed(int64_t limit_bytes) && {
  if (!weight.defined() || !weight.is_cpu() || weight.scalar_type() != torch::kFloat32 ||
      static_cast<int64_t>(weight.nbytes()) > limit_bytes) {
    return std::move(*this);
  }
  const int64_t padded = PadToPanel(out);
  panels = at::zeros({padded, in}, weight.options());
  panels.narrow(0, 0, out).copy_(weight);
  panels = panels.view({padded / kPanel, kPanel, in}).transpose(1, 2).contiguous();
  return std::move(*this);
}

torch::Tensor Project(const Projection& projection, const torch::Tensor& x,
                      const Adapters& adapters, size_t first, int64_t batch) {
  const torch::Tensor rows = x.reshape({-1, projection.in});
  const torch::Tensor y = at::empty({rows.size(0), projection.out}, rows.options());
  if (projection.panels.defined() && rows.size(0) <= kPackedRows) {
    MultiplyPacked(rows, projection, y);
  } else if (projection.weight.defined()) {
    Multiply(rows, projection.weight, projection.bias, y);
  }
  int64_t column = 0;
  for (size_t i = 0; i < projection.parts.size(); ++i) {
    const Linear& part = projection.parts[i];
    torch::Tensor columns = y.narrow(1, column, part.weight.size(0));
    column += columns.size(1);
    if (!projection.weight.defined()) Multiply(rows, part.weight, part.bias, columns);
    if (part.lora_A.defined()) AddAdapter(rows, part.lora_A, part.lora_B, part.lora_scale, columns);
    if (adapters.A.empty()) continue;
    const torch::Tensor &A = adapters.A[first + i], &B = adapters.B[first + i];
    if (adapters.rows) {
      columns.add_(LoraRowsDelta(rows.view({batch, -1, projection.in}), A, B).flatten(0, 1));
    } else {
      AddAdapter(rows, A, B, 1, columns);
    }
  }
  return y;
}

}  // namespace robostress::openpi
