#include "server/policies/openpi/cached_attention.h"

#include <ATen/Parallel.h>
#include <torch/autograd.h>
#include <torch/types.h>

#include <cmath>

#include "server/policies/kernels/fused_kernels.h"

namespace robostress::openpi {
namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::variable_list;

// [B, heads, T, h] -> [B kv_heads, group T, h], a key head's query heads below each other.
Tensor Grouped(const Tensor& x, int64_t kv_heads) {
  return x.reshape({x.size(0) * kv_heads, -1, x.size(3)});
}

struct StoredAttention : torch::autograd::Function<StoredAttention> {
  static Tensor forward(AutogradContext* context, const Tensor& q, const Tensor& k, const Tensor& v,
                        const Tensor& prefix_k, const Tensor& prefix_v, const Tensor& mask) {
    const int64_t batch = q.size(0), heads = q.size(1), tokens = q.size(2), h = q.size(3);
    const int64_t kv_heads = k.size(1), group = heads / kv_heads;
    const double scale = 1 / std::sqrt(static_cast<double>(h));
    const Tensor queries = Grouped(q * scale, kv_heads);
    const Tensor keys = at::cat({prefix_k, k}, 2).flatten(0, 1);  // [B kv_heads, S, h]
    const Tensor values = at::cat({prefix_v, v}, 2).flatten(0, 1);
    const Tensor weights = at::bmm(queries, keys.transpose(1, 2));  // [B kv_heads, group T, S]
    const Tensor bias = mask.contiguous();
    const int64_t slots = keys.size(1);
    at::parallel_for(0, batch * heads, 1, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {  // one query head of one row
        BestFusedKernels().softmax_bias(
            weights.data_ptr<float>() + i * tokens * slots,
            bias.data_ptr<float>() + i / (kv_heads * group) * tokens * slots, 1, tokens, slots,
            /*heads=*/1, /*bias_rows=*/tokens, /*draws=*/1);
      }
    });
    context->save_for_backward({queries, keys, values, weights});
    context->saved_data["tokens"] = tokens;
    context->saved_data["kv_heads"] = kv_heads;
    context->saved_data["scale"] = scale;
    return at::bmm(weights, values)
        .view({batch, heads, tokens, h})
        .transpose(1, 2)
        .reshape({batch, tokens, heads * h});
  }

  static variable_list backward(AutogradContext* context, variable_list grads) {
    const variable_list saved = context->get_saved_variables();
    const Tensor &queries = saved[0], &keys = saved[1], &values = saved[2], &weights = saved[3];
    const int64_t tokens = context->saved_data["tokens"].toInt(), h = queries.size(2);
    const int64_t kv_heads = context->saved_data["kv_heads"].toInt();
    const int64_t batch = queries.size(0) / kv_heads, slots = keys.size(1);
    const Tensor grad = Grouped(grads[0].view({batch, tokens, -1, h}).transpose(1, 2), kv_heads);
    const auto to_suffix = [&](const Tensor& of_slots, const Tensor& rows) {
      return at::bmm(of_slots.narrow(2, slots - tokens, tokens).transpose(1, 2), rows)
          .view({batch, kv_heads, tokens, h});
    };
    const Tensor grad_v = to_suffix(weights, grad);
    const Tensor scores = at::bmm(grad, values.transpose(1, 2));  // gradient of the weights, then
    const int64_t rows = scores.size(0) * scores.size(1);         // of the scores
    at::parallel_for(0, rows, tokens, [&](int64_t begin, int64_t end) {
      float* row = scores.data_ptr<float>() + begin * slots;
      BestFusedKernels().softmax_backward(weights.data_ptr<float>() + begin * slots, row,
                                          end - begin, slots, row);
    });
    const Tensor grad_q = at::bmm(scores, keys) * context->saved_data["scale"].toDouble();
    return {grad_q.view({batch, -1, tokens, h}),
            to_suffix(scores, queries),
            grad_v,
            Tensor(),
            Tensor(),
            Tensor()};
  }
};

}  // namespace

Tensor AttendToStored(const Tensor& q, const Tensor& k, const Tensor& v, const Tensor& prefix_k,
                      const Tensor& prefix_v, const Tensor& mask) {
  return StoredAttention::apply(q, k, v, prefix_k, prefix_v, mask);
}

}  // namespace robostress::openpi
