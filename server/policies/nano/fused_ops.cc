#include "server/policies/nano/fused_ops.h"

#include <torch/autograd.h>
#include <torch/types.h>

#include "common/check.h"
#include "server/policies/kernels/fused_kernels.h"

namespace robostress {
namespace {

using torch::Tensor;
using torch::autograd::AutogradContext;
using torch::autograd::Function;
using torch::autograd::variable_list;

const FusedKernels& Kernels() { return BestFusedKernels(); }

const float* Data(const Tensor& tensor) {
  return tensor.defined() ? tensor.data_ptr<float>() : nullptr;
}

variable_list ComputeNorm(const Tensor& x, const Tensor& delta, const Tensor& weight) {
  const int64_t width = x.size(-1), rows = x.numel() / width;
  const Tensor sum = delta.defined() ? torch::empty_like(x) : x;
  const Tensor y = torch::empty_like(x);
  const Tensor inverse_rms = torch::empty({rows});
  Kernels().add_rms_norm(Data(x), Data(delta), Data(weight), rows, width,
                         delta.defined() ? sum.data_ptr<float>() : nullptr, y.data_ptr<float>(),
                         inverse_rms.data_ptr<float>());
  return {sum, y, inverse_rms};
}

// (grad of x and of delta alike, grad of weight).
std::pair<Tensor, Tensor> NormBackward(const variable_list& saved, Tensor grad_sum, Tensor grad_y) {
  const Tensor &sum = saved[0], &weight = saved[1], &inverse_rms = saved[2];
  if (grad_sum.defined()) grad_sum = grad_sum.contiguous();
  grad_y = grad_y.contiguous();
  const int64_t width = sum.size(-1), rows = sum.numel() / width;
  const Tensor grad_x = torch::empty_like(sum);
  const Tensor grad_weight = weight.requires_grad() ? torch::zeros_like(weight) : Tensor();
  Kernels().add_rms_norm_backward(Data(grad_sum), Data(grad_y), Data(sum), Data(weight),
                                  Data(inverse_rms), rows, width, grad_x.data_ptr<float>(),
                                  grad_weight.defined() ? grad_weight.data_ptr<float>() : nullptr);
  return {grad_x, grad_weight};
}

struct RmsNormFunction : Function<RmsNormFunction> {
  static Tensor forward(AutogradContext* context, const Tensor& x, const Tensor& weight) {
    const variable_list out = ComputeNorm(x, Tensor(), weight);
    context->save_for_backward({x, weight, out[2]});
    return out[1];
  }
  static variable_list backward(AutogradContext* context, variable_list grads) {
    const auto [grad_x, grad_weight] =
        NormBackward(context->get_saved_variables(), Tensor(), grads[0]);
    return {grad_x, grad_weight};
  }
};

struct AddRmsNormFunction : Function<AddRmsNormFunction> {
  static variable_list forward(AutogradContext* context, const Tensor& x, const Tensor& delta,
                               const Tensor& weight) {
    const variable_list out = ComputeNorm(x, delta, weight);
    context->save_for_backward({out[0], weight, out[2]});
    return {out[0], out[1]};
  }
  static variable_list backward(AutogradContext* context, variable_list grads) {
    const auto [grad_x, grad_weight] =
        NormBackward(context->get_saved_variables(), grads[0], grads[1]);
    return {grad_x, grad_x, grad_weight};
  }
};

struct GeGluFunction : Function<GeGluFunction> {
  static Tensor Compute(const Tensor& gate_up) {
    const int64_t width = gate_up.size(-1) / 2, rows = gate_up.numel() / gate_up.size(-1);
    auto shape = gate_up.sizes().vec();
    shape.back() = width;
    Tensor y = torch::empty(shape);
    Kernels().geglu(Data(gate_up), rows, width, y.data_ptr<float>());
    return y;
  }
  static Tensor forward(AutogradContext* context, const Tensor& gate_up) {
    context->save_for_backward({gate_up});
    return Compute(gate_up);
  }
  static variable_list backward(AutogradContext* context, variable_list grads) {
    const Tensor gate_up = context->get_saved_variables()[0];
    const Tensor grad_y = grads[0].contiguous();
    const Tensor grad = torch::empty_like(gate_up);
    const int64_t width = gate_up.size(-1) / 2;
    Kernels().geglu_backward(Data(gate_up), Data(grad_y), gate_up.numel() / (2 * width), width,
                             grad.data_ptr<float>());
    return {grad};
  }
};

struct SplitRopeFunction : Function<SplitRopeFunction> {
  static variable_list Compute(const Tensor& qkv, const Tensor& cos, const Tensor& sin,
                               const Tensor& position, int64_t heads, double q_scale) {
    const int64_t batch = qkv.size(0), length = qkv.size(1), h = 2 * cos.size(1);
    const Tensor q = torch::empty({batch, length * heads, h}), k = torch::empty({batch, length, h}),
                 v = torch::empty({batch, length, h});
    Kernels().split_rope(qkv.data_ptr<float>(), Data(cos), Data(sin), position.data_ptr<int64_t>(),
                         static_cast<float>(q_scale), batch * length, heads, h, false,
                         q.data_ptr<float>(), k.data_ptr<float>(), v.data_ptr<float>());
    return {q, k, v};
  }
  static variable_list forward(AutogradContext* context, const Tensor& qkv, const Tensor& cos,
                               const Tensor& sin, const Tensor& position, int64_t heads,
                               double q_scale) {
    context->save_for_backward({cos, sin, position});
    context->saved_data["heads"] = heads;
    context->saved_data["q_scale"] = q_scale;
    return Compute(qkv, cos, sin, position, heads, q_scale);
  }
  static variable_list backward(AutogradContext* context, variable_list grads) {
    const variable_list saved = context->get_saved_variables();
    const int64_t heads = context->saved_data["heads"].toInt(), h = 2 * saved[0].size(1);
    // A gradient is undefined where nothing used that output (the queries of a layer whose keys
    // alone are read).
    const auto defined = [](const Tensor& grad, const Tensor& other, int64_t factor) {
      if (grad.defined()) return grad.contiguous();
      return torch::zeros({other.size(0), other.size(1) * factor, other.size(2)});
    };
    const Tensor& some = grads[1].defined() ? grads[1] : grads[2];
    RS_CHECK(some.defined());
    Tensor q = defined(grads[0], some, heads), k = defined(grads[1], some, 1),
           v = defined(grads[2], some, 1);
    const int64_t batch = k.size(0), length = k.size(1);
    const Tensor grad = torch::empty({batch, length, (heads + 2) * h});
    Kernels().split_rope(
        grad.data_ptr<float>(), Data(saved[0]), Data(saved[1]), saved[2].data_ptr<int64_t>(),
        static_cast<float>(context->saved_data["q_scale"].toDouble()), batch * length, heads, h,
        true, q.data_ptr<float>(), k.data_ptr<float>(), v.data_ptr<float>());
    return {grad, Tensor(), Tensor(), Tensor(), Tensor(), Tensor()};
  }
};

struct SoftmaxBiasFunction : Function<SoftmaxBiasFunction> {
  static void Compute(Tensor& scores, const Tensor& bias, int64_t heads) {
    Kernels().softmax_bias(scores.data_ptr<float>(), Data(bias), scores.size(0), scores.size(1),
                           scores.size(2), heads, bias.size(1), scores.size(0) / bias.size(0));
  }
  static Tensor forward(AutogradContext* context, Tensor scores, const Tensor& bias,
                        int64_t heads) {
    Compute(scores, bias, heads);
    context->mark_dirty({scores});
    context->save_for_backward({scores});
    return scores;
  }
  static variable_list backward(AutogradContext* context, variable_list grads) {
    const Tensor p = context->get_saved_variables()[0];
    const Tensor grad_p = grads[0].contiguous();
    const Tensor grad = torch::empty_like(p);
    Kernels().softmax_backward(Data(p), Data(grad_p), p.numel() / p.size(-1), p.size(-1),
                               grad.data_ptr<float>());
    return {grad, Tensor(), Tensor()};
  }
};

bool Records(std::initializer_list<std::reference_wrapper<const Tensor>> inputs) {
  if (!torch::GradMode::is_enabled()) return false;
  for (const Tensor& input : inputs) {
    if (input.defined() && input.requires_grad()) return true;
  }
  return false;
}

}  // namespace

std::pair<Tensor, Tensor> AddRmsNorm(const Tensor& x, const Tensor& delta, const Tensor& weight) {
  const Tensor rows = x.contiguous(), added = delta.defined() ? delta.contiguous() : delta;
  if (!Records({rows, added, weight})) {
    const variable_list out = ComputeNorm(rows, added, weight);
    return {out[0], out[1]};
  }
  if (!delta.defined()) return {rows, RmsNormFunction::apply(rows, weight)};
  const variable_list out = AddRmsNormFunction::apply(rows, added, weight);
  return {out[0], out[1]};
}

Tensor GeGlu(const Tensor& gate_up) {
  const Tensor rows = gate_up.contiguous();
  return Records({rows}) ? GeGluFunction::apply(rows) : GeGluFunction::Compute(rows);
}

Heads SplitRope(const Tensor& qkv, const Tensor& cos, const Tensor& sin, const Tensor& position,
                int64_t heads, double q_scale) {
  const Tensor rows = qkv.contiguous();
  RS_CHECK(position.numel() == rows.size(0) * rows.size(1) &&
           rows.size(2) == (heads + 2) * 2 * cos.size(1));
  const variable_list out =
      Records({rows}) ? SplitRopeFunction::apply(rows, cos, sin, position, heads, q_scale)
                      : SplitRopeFunction::Compute(rows, cos, sin, position, heads, q_scale);
  return {out[0], out[1], out[2]};
}

Tensor SoftmaxBias(Tensor scores, const Tensor& bias, int64_t heads) {
  RS_CHECK(scores.is_contiguous() && bias.is_contiguous() && bias.size(2) == scores.size(2));
  if (Records({scores})) return SoftmaxBiasFunction::apply(scores, bias, heads);
  SoftmaxBiasFunction::Compute(scores, bias, heads);
  return scores;
}

}  // namespace robostress
