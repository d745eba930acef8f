#include <cuda_bf16.h>

#include "server/policies/openpi/gpu_kernels.h"

namespace robostress::openpi::gpu {
namespace {

constexpr int kThreads = 256;
constexpr int kWarp = 32;
constexpr float kEpsilon = 1e-6f;

__device__ float Load(float x) { return x; }
__device__ float Load(__nv_bfloat16 x) { return __bfloat162float(x); }
template <class T>
__device__ T Round(float x);
template <>
__device__ float Round<float>(float x) {
  return x;
}
template <>
__device__ __nv_bfloat16 Round<__nv_bfloat16>(float x) {
  return __float2bfloat16(x);
}

struct Sum {
  static constexpr float kNeutral = 0;
  __device__ float operator()(float a, float b) const { return a + b; }
};
struct Max {
  static constexpr float kNeutral = -3.402823466e38f;
  __device__ float operator()(float a, float b) const { return fmaxf(a, b); }
};

// Of all threads of the block, for all of them.
template <class Operation>
__device__ float Reduce(float value, Operation operation) {
  __shared__ float of_warps[kThreads / kWarp];
  for (int offset = kWarp / 2; offset > 0; offset /= 2)
    value = operation(value, __shfl_xor_sync(~0u, value, offset));
  __syncthreads();  // the values of a reduction before have been read
  if (threadIdx.x % kWarp == 0) of_warps[threadIdx.x / kWarp] = value;
  __syncthreads();
  value =
      threadIdx.x % kWarp < kThreads / kWarp ? of_warps[threadIdx.x % kWarp] : Operation::kNeutral;
  for (int offset = kWarp / 2; offset > 0; offset /= 2)
    value = operation(value, __shfl_xor_sync(~0u, value, offset));
  return value;
}

// A block a row.
template <class T>
__global__ void AddRmsNormRows(T* x, const T* branch, const T* gate, const float* scale,
                               const float* shift, int64_t width, T* y) {
  const int64_t row = blockIdx.x * width;
  float squares = 0;
  for (int64_t i = threadIdx.x; i < width; i += kThreads) {
    float value = Load(x[row + i]);
    if (branch != nullptr) {
      float added = Load(branch[row + i]);
      if (gate != nullptr) added = Load(Round<T>(added * Load(gate[i])));
      x[row + i] = Round<T>(value + added);
      value = Load(x[row + i]);
    }
    squares += value * value;
  }
  const float inverse = rsqrtf(Reduce(squares, Sum()) / static_cast<float>(width) + kEpsilon);
  for (int64_t i = threadIdx.x; i < width; i += kThreads) {
    const float normed = Load(x[row + i]) * inverse * (1 + scale[i]);
    y[row + i] = Round<T>(shift == nullptr ? normed : normed + shift[i]);
  }
}

// A block a token; a thread pairs the halves of a head, which a rotation mixes.
template <class T>
__global__ void SplitHeadsRows(const T* qkv, const float* cos, const float* sin, float scale,
                               int64_t tokens, int64_t heads, int64_t kv_heads, int64_t head_dim,
                               T* q, T* k, T* v) {
  const int64_t half = head_dim / 2, group = heads / kv_heads;
  const int64_t token = blockIdx.x % tokens, item = blockIdx.x / tokens * kv_heads;
  const int64_t columns = heads + 2 * kv_heads;
  for (int64_t c = threadIdx.x; c < columns * half; c += kThreads) {
    const int64_t head = c / half, i = c % half;
    const T* from = qkv + (blockIdx.x * columns + head) * head_dim + i;
    T* to;
    if (head < heads) {
      to = q + (((item + head / group) * tokens + token) * group + head % group) * head_dim + i;
    } else if (head < heads + kv_heads) {
      to = k + ((item + head - heads) * tokens + token) * head_dim + i;
    } else {
      to = v + ((item + head - heads - kv_heads) * tokens + token) * head_dim + i;
      to[0] = from[0];
      to[half] = from[half];
      continue;
    }
    const float factor = head < heads ? scale : 1;
    const float a = Load(from[0]), b = Load(from[half]);
    if (cos == nullptr) {
      to[0] = Round<T>(a * factor);
      to[half] = Round<T>(b * factor);
    } else {
      const float turn_cos = cos[blockIdx.x * half + i] * factor;
      const float turn_sin = sin[blockIdx.x * half + i] * factor;
      to[0] = Round<T>(a * turn_cos - b * turn_sin);
      to[half] = Round<T>(b * turn_cos + a * turn_sin);
    }
  }
}

// A block a row of scores.
template <class T>
__global__ void SoftmaxRows(T* scores, const float* mask, MaskShape shape, int64_t rows,
                            int64_t group, int64_t keys) {
  const int64_t item = blockIdx.x / rows, query = blockIdx.x % rows / group;
  T* row = scores + blockIdx.x * keys;
  const float* bias =
      mask == nullptr
          ? nullptr
          : mask +
                (item / shape.items_per_mask * shape.rows + (shape.rows == 1 ? 0 : query)) * keys;
  const auto score = [&](int64_t i) { return Load(row[i]) + (bias == nullptr ? 0 : bias[i]); };
  float most = Max::kNeutral;
  for (int64_t i = threadIdx.x; i < keys; i += kThreads) most = fmaxf(most, score(i));
  most = Reduce(most, Max());
  float sum = 0;
  for (int64_t i = threadIdx.x; i < keys; i += kThreads) sum += expf(score(i) - most);
  sum = Reduce(sum, Sum());
  for (int64_t i = threadIdx.x; i < keys; i += kThreads)
    row[i] = Round<T>(expf(score(i) - most) / sum);
}

template <class T>
__global__ void GeGluElements(const T* gate_up, int64_t count, int64_t width, T* y) {
  const int64_t i = blockIdx.x * static_cast<int64_t>(kThreads) + threadIdx.x;
  if (i >= count) return;
  const T* gate = gate_up + i / width * 2 * width + i % width;
  const float x = Load(gate[0]);
  const float inner = 0.7978845608028654f * (x + 0.044715f * x * x * x);  // sqrt(2 / pi)
  const float gelu = Load(Round<T>(0.5f * x * (1 + tanhf(inner))));
  y[i] = Round<T>(gelu * Load(gate[width]));
}

// f(a null pointer to the elements' type).
template <class F>
void ForType(Element type, F&& f) {
  if (type == Element::kFloat32) {
    f(static_cast<float*>(nullptr));
  } else {
    f(static_cast<__nv_bfloat16*>(nullptr));
  }
}

cudaStream_t On(void* stream) { return static_cast<cudaStream_t>(stream); }

}  // namespace

void AddRmsNorm(Element type, void* x, const void* branch, const void* gate, const float* scale,
                const float* shift, int64_t rows, int64_t width, void* y, void* stream) {
  if (rows == 0) return;
  ForType(type, [&](auto* of_type) {
    using T = std::remove_pointer_t<decltype(of_type)>;
    AddRmsNormRows<T><<<static_cast<unsigned>(rows), kThreads, 0, On(stream)>>>(
        static_cast<T*>(x), static_cast<const T*>(branch), static_cast<const T*>(gate), scale,
        shift, width, static_cast<T*>(y));
  });
}

void SplitHeads(Element type, const void* qkv, const float* cos, const float* sin, float scale,
                int64_t batch, int64_t tokens, int64_t heads, int64_t kv_heads, int64_t head_dim,
                void* q, void* k, void* v, void* stream) {
  if (batch * tokens == 0) return;
  ForType(type, [&](auto* of_type) {
    using T = std::remove_pointer_t<decltype(of_type)>;
    SplitHeadsRows<T><<<static_cast<unsigned>(batch * tokens), kThreads, 0, On(stream)>>>(
        static_cast<const T*>(qkv), cos, sin, scale, tokens, heads, kv_heads, head_dim,
        static_cast<T*>(q), static_cast<T*>(k), static_cast<T*>(v));
  });
}

void Softmax(Element type, void* scores, const float* mask, const MaskShape& shape, int64_t items,
             int64_t queries, int64_t group, int64_t keys, void* stream) {
  const int64_t rows = queries * group;
  if (items * rows == 0) return;
  ForType(type, [&](auto* of_type) {
    using T = std::remove_pointer_t<decltype(of_type)>;
    SoftmaxRows<T><<<static_cast<unsigned>(items * rows), kThreads, 0, On(stream)>>>(
        static_cast<T*>(scores), mask, shape, rows, group, keys);
  });
}

void GeGlu(Element type, const void* gate_up, int64_t rows, int64_t width, void* y, void* stream) {
  const int64_t count = rows * width;
  if (count == 0) return;
  ForType(type, [&](auto* of_type) {
    using T = std::remove_pointer_t<decltype(of_type)>;
    GeGluElements<T>
        <<<static_cast<unsigned>((count + kThreads - 1) / kThreads), kThreads, 0, On(stream)>>>(
            static_cast<const T*>(gate_up), count, width, static_cast<T*>(y));
  });
}

}  // namespace robostress::openpi::gpu
