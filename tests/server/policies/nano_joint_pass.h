#pragma once

#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include "server/policies/nano/nano_network.h"

// nano's velocity once more, independently: one pass over prefix and suffix together, no cache,
// plain operators.
namespace robostress {

inline torch::Tensor PlainNorm(const torch::Tensor& x, const torch::Tensor& weight) {
  return x / torch::sqrt(x.square().mean(-1, true) + 1e-6) * (1.0 + weight);
}

// x [T, H, h] at integer positions [T].
inline torch::Tensor PlainRope(const torch::Tensor& x, const torch::Tensor& position) {
  const int64_t half = x.size(-1) / 2;
  torch::Tensor out = torch::zeros_like(x);
  for (int64_t t = 0; t < x.size(0); ++t) {
    for (int64_t j = 0; j < half; ++j) {
      const double angle =
          position[t].item<double>() *
          std::pow(10000.0, -2.0 * static_cast<double>(j) / static_cast<double>(2 * half));
      const torch::Tensor x1 = x[t].select(-1, j), x2 = x[t].select(-1, j + half);
      out[t].select(-1, j).copy_(x1 * std::cos(angle) - x2 * std::sin(angle));
      out[t].select(-1, j + half).copy_(x2 * std::cos(angle) + x1 * std::sin(angle));
    }
  }
  return out;
}

struct JointInput {
  std::vector<torch::Tensor> images;  // per camera [1, 3, s, s]
  torch::Tensor words;                // [max_words]
  torch::Tensor state;                // [state_dim]
  torch::Tensor x;                    // [K, d]
  double u = 0;
};

// A norm by its equation: the plain one, or with scale, shift and gate from cond [w].
struct PlainNormed {
  torch::Tensor y, gate;
};
inline PlainNormed AnyNorm(const torch::Tensor& x, const NanoNorm& norm,
                           const torch::Tensor& cond) {
  if (!norm.dense.defined()) return {PlainNorm(x, norm.weight), torch::ones({1})};
  const auto m = (torch::matmul(norm.dense, cond) + norm.dense_bias).chunk(3, 0);
  return {PlainNorm(x, m[0]) + m[1], m[2]};
}

// The velocity by the rule of pi0: query i may see key j iff cumsum(block)[j] <= cumsum(block)[i]
// and both are valid; blocks start at the state, where it is a token, and at the first action.
inline torch::Tensor JointVelocity(const NanoConfig& c, const NanoParameters& p,
                                   const JointInput& input) {
  std::vector<torch::Tensor> prefix = {p.readout};
  for (size_t v = 0; v < p.cameras.size(); ++v) {
    torch::Tensor y = input.images[v];
    for (size_t i = 0; i < p.cameras[v].conv_weight.size(); ++i) {
      const int64_t pad = (p.cameras[v].conv_weight[i].size(-1) - 1) / 2;
      y = torch::relu(
          torch::conv2d(y, p.cameras[v].conv_weight[i], p.cameras[v].conv_bias[i], 2, pad));
    }
    y = y[0].flatten(1).t();  // [grid^2, channels]
    prefix.push_back(torch::matmul(y, p.cameras[v].token_weight.t()) + p.cameras[v].token_bias +
                     p.cameras[v].position);
  }
  for (int j = 0; j < c.state_words(); ++j) {
    const double share = (input.state[j].item<double>() + c.state_span) / (2 * c.state_span);
    const int bin =
        std::clamp(static_cast<int>(std::floor(share * c.state_bins)), 0, c.state_bins - 1);
    prefix.push_back((p.state_words[bin] + p.state_position[j]).unsqueeze(0));
  }
  prefix.push_back(p.words.index_select(0, input.words) *
                   std::sqrt(static_cast<double>(c.prefix_width)));
  torch::Tensor a = torch::cat(prefix);  // [P, w]

  const int64_t tokens = c.action_tokens(), e = c.expert_width;
  torch::Tensor time = torch::zeros({e});
  for (int64_t k = 0; k < e / 2; ++k) {
    const int64_t last = e / 2 - 1;
    const double period =
        4e-3 * std::pow(4.0 / 4e-3, static_cast<double>(k) / static_cast<double>(last));
    time[k] = std::sin(2.0 * std::numbers::pi * input.u / period);
    time[k + e / 2] = std::cos(2.0 * std::numbers::pi * input.u / period);
  }
  const torch::Tensor action =
      torch::matmul(input.x.reshape({tokens, -1}), p.action_in_weight.t()) + p.action_in_bias;
  torch::Tensor b = action, cond;  // [suffix tokens, e], [e]
  if (c.pi05()) {
    const torch::Tensor hidden =
        torch::silu(torch::matmul(p.time_in_weight, time) + p.time_in_bias);
    cond = torch::silu(torch::matmul(p.time_out_weight, hidden) + p.time_out_bias);
  } else {
    const torch::Tensor both = torch::cat({action, time.unsqueeze(0).expand({tokens, e})}, 1);
    const torch::Tensor mixed =
        torch::silu(torch::matmul(both, p.time_in_weight.t()) + p.time_in_bias);
    const torch::Tensor timed = torch::matmul(mixed, p.time_out_weight.t()) + p.time_out_bias;
    const torch::Tensor state =
        torch::matmul(input.state.unsqueeze(0), p.state_weight.t()) + p.state_bias;
    b = torch::cat({state, timed});
  }

  const int64_t length = a.size(0) + b.size(0), first_word = a.size(0) - c.max_words;
  torch::Tensor valid = torch::ones({length}, torch::kBool),
                block = torch::zeros({length}, torch::kInt64);
  valid.narrow(0, first_word, c.max_words).copy_(input.words.ne(0));
  block[a.size(0)] = 1;
  if (!c.pi05()) block[a.size(0) + 1] = 1;
  const torch::Tensor level = block.cumsum(0), position = valid.to(torch::kInt64).cumsum(0) - 1;
  const torch::Tensor sees = (level.unsqueeze(0) <= level.unsqueeze(1)) & valid.unsqueeze(0);

  for (int i = 0; i < c.layers; ++i) {
    const NanoLayer &la = p.prefix[i], &lb = p.expert[i];
    const bool last = i + 1 == c.layers;  // nobody reads the prefix after its last keys
    const int64_t h = c.head_dim, hq = c.heads * h;
    const PlainNormed na = AnyNorm(a, la.input_norm, cond), nb = AnyNorm(b, lb.input_norm, cond);
    const torch::Tensor ya = torch::matmul(na.y, la.qkv_proj.t());
    const torch::Tensor yb = torch::matmul(nb.y, lb.qkv_proj.t());
    const torch::Tensor qa = last ? torch::zeros({a.size(0), hq}) : ya.narrow(1, 0, hq);
    const torch::Tensor q =
        PlainRope(torch::cat({qa, yb.narrow(1, 0, hq)}).view({length, c.heads, h}), position);
    const torch::Tensor ka = ya.narrow(1, last ? 0 : hq, h),
                        va = ya.narrow(1, last ? h : hq + h, h);
    const torch::Tensor k =
        PlainRope(torch::cat({ka, yb.narrow(1, hq, h)}).view({length, 1, h}), position);
    const torch::Tensor v = torch::cat({va, yb.narrow(1, hq + h, h)});
    std::vector<torch::Tensor> heads;
    for (int head = 0; head < c.heads; ++head) {
      const torch::Tensor scores =
          torch::matmul(q.select(1, head), k.select(1, 0).t()) / std::sqrt(static_cast<double>(h));
      heads.push_back(torch::matmul(torch::softmax(scores.masked_fill(~sees, -1e30), -1), v));
    }
    const torch::Tensor attended = torch::cat(heads, 1);
    const auto finish = [&](const torch::Tensor& x, const torch::Tensor& rows,
                            const torch::Tensor& gate, const NanoLayer& l, int64_t mlp) {
      const torch::Tensor mid = x + gate * torch::matmul(rows, l.o_proj.t());
      const PlainNormed n = AnyNorm(mid, l.post_norm, cond);
      const auto parts = torch::matmul(n.y, l.gate_up_proj.t()).split(mlp, -1);
      return mid + n.gate * torch::matmul(at::gelu(parts[0], "tanh") * parts[1], l.down_proj.t());
    };
    if (!last) a = finish(a, attended.narrow(0, 0, a.size(0)), na.gate, la, c.prefix_mlp);
    b = finish(b, attended.narrow(0, a.size(0), b.size(0)), nb.gate, lb, c.expert_mlp);
  }
  const torch::Tensor out = AnyNorm(b.narrow(0, b.size(0) - tokens, tokens), p.expert_norm, cond).y;
  return (torch::matmul(out, p.action_out_weight.t()) + p.action_out_bias)
      .reshape({c.horizon, c.model_action_dim});
}

}  // namespace robostress
