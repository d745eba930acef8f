#pragma once

#include <cstdint>

namespace robostress {

// Loops over float32 rows for the operations between the matrix products of a transformer layer.
// LibTorch 1.13 runs them as chains of passes over memory (and its tanh-GELU at 3 ns per element):
// they were half of a training step. One table per instruction set, compiled from the same text.
struct FusedKernels {
  // sum = x + delta (delta may be null), y = sum / rms(sum) * (1 + weight); inverse_rms [rows].
  void (*add_rms_norm)(const float* x, const float* delta, const float* weight, int64_t rows,
                       int64_t width, float* sum, float* y, float* inverse_rms);
  // grad_x = grad_sum + d(y)/d(sum) grad_y; adds to grad_weight (may be null). grad_sum may be
  // null.
  void (*add_rms_norm_backward)(const float* grad_sum, const float* grad_y, const float* sum,
                                const float* weight, const float* inverse_rms, int64_t rows,
                                int64_t width, float* grad_x, float* grad_weight);
  // y = gelu_tanh(gate) * up; gate_up rows hold gate, then up.
  void (*geglu)(const float* gate_up, int64_t rows, int64_t width, float* y);
  void (*geglu_backward)(const float* gate_up, const float* grad_y, int64_t rows, int64_t width,
                         float* grad_gate_up);
  // Rows of q (heads of size h), k, v -> q and k rotated by half-split RoPE, q scaled, v copied.
  // cos and sin hold h/2 numbers per row; row r uses cos_row[r]. With `inverse`, the adjoint: reads
  // q, k, v and writes the fused rows.
  void (*split_rope)(float* qkv, const float* cos, const float* sin, const int64_t* cos_row,
                     float q_scale, int64_t rows, int64_t heads, int64_t head_dim, bool inverse,
                     float* q, float* k, float* v);
  // In place: softmax(scores + bias) over the last dimension. Row r uses bias row bias_row(r) =
  // (r / rows_per_bias_block) * bias_rows + (r % queries) / heads % bias_rows, where queries is the
  // rows of one batch item.
  void (*softmax_bias)(float* scores, const float* bias, int64_t batch, int64_t queries,
                       int64_t keys, int64_t heads, int64_t bias_rows, int64_t draws);
  // grad_scores = p * (grad_p - sum(p grad_p)).
  void (*softmax_backward)(const float* p, const float* grad_p, int64_t rows, int64_t keys,
                           float* grad_scores);
  // y = x W^T for few rows: W [out, in] packed into panels of kPanel outputs, [panel][in][kPanel],
  // the last one filled up with zeros. A row's result does not depend on the other rows.
  void (*linear)(const float* x, int64_t rows, int64_t in, const float* panels, int64_t out,
                 float* y);
  // y += (x A^T) B^T with A [rank, in] and B transposed, [rank, out]; rows of x and y are x_stride
  // and y_stride apart.
  void (*add_low_rank)(const float* x, int64_t x_stride, int64_t rows, int64_t in, const float* a,
                       const float* b_transposed, int64_t rank, int64_t out, float* y,
                       int64_t y_stride);
  // In place: gelu_tanh(x).
  void (*gelu)(float* x, int64_t n);
  // y = x, given as the bits of bfloat16; exact.
  void (*widen_bf16)(const uint16_t* x, int64_t n, float* y);
};

inline constexpr int64_t kPanel = 16;
constexpr int64_t PadToPanel(int64_t n) { return (n + kPanel - 1) / kPanel * kPanel; }

// The best table for this processor.
const FusedKernels& BestFusedKernels();
const FusedKernels& GenericFusedKernels();
#if defined(__x86_64__)
const FusedKernels& Avx2FusedKernels();
#endif

}  // namespace robostress
