#pragma once

#include <cstdint>

namespace robostress::openpi::gpu {

// What layer_ops.h does between the products of a layer, each as one kernel where LibTorch starts
// up to eleven: an expert's layers are so small that starting kernels is what they cost. Elements
// are float32 or bfloat16 and contiguous, statistics and angles float32. Pointers are to memory of
// the current GPU; nothing waits, and a kernel that cannot start is what cudaGetLastError says.
enum class Element { kFloat32, kBfloat16 };

// x [rows, width] += gate branch, then y = x rsqrt(mean(x^2) + 1e-6) (1 + scale) + shift.
// `branch`, and `gate` and `shift` [width], may be null. scale and shift are float32.
void AddRmsNorm(Element type, void* x, const void* branch, const void* gate, const float* scale,
                const float* shift, int64_t rows, int64_t width, void* y, void* stream);

// qkv [batch tokens, (heads + 2 kv_heads) h] -> q [batch kv_heads, tokens group, h] times `scale`,
// k and v [batch kv_heads, tokens, h]. q and k are rotated where cos and sin [batch tokens, h / 2]
// are given.
void SplitHeads(Element type, const void* qkv, const float* cos, const float* sin, float scale,
                int64_t batch, int64_t tokens, int64_t heads, int64_t kv_heads, int64_t head_dim,
                void* q, void* k, void* v, void* stream);

// scores [items, queries group, keys] become their softmax over keys. `mask` is null or added:
// [items / items_per_mask or 1, mask_rows: queries or 1, keys].
struct MaskShape {
  int64_t items_per_mask = 1, rows = 1;
};
void Softmax(Element type, void* scores, const float* mask, const MaskShape& shape, int64_t items,
             int64_t queries, int64_t group, int64_t keys, void* stream);

// gate_up [rows, 2 width] -> gelu_tanh(gate) up [rows, width].
void GeGlu(Element type, const void* gate_up, int64_t rows, int64_t width, void* y, void* stream);

}  // namespace robostress::openpi::gpu
