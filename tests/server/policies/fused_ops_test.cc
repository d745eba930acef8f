#include "server/policies/nano/fused_ops.h"

#include <gtest/gtest.h>
#include <torch/autograd.h>
#include <torch/types.h>

#include "server/policies/kernels/fused_kernels.h"

namespace robostress {
namespace {

using torch::Tensor;

// Largest difference, relative to the size of the numbers.
double Difference(const Tensor& a, const Tensor& b) {
  return ((a - b).abs().max() / (1.0 + b.abs().max())).item<double>();
}

Tensor Leaf(torch::IntArrayRef shape) { return torch::randn(shape).set_requires_grad(true); }

// Gradients of sum(f * w) for random w, through both implementations, for every leaf.
template <class Fused, class Plain>
void ExpectSameValueAndGradients(const std::vector<Tensor>& leaves, Fused fused, Plain plain) {
  const Tensor a = fused(), b = plain();
  // Single precision, sums of up to a hundred terms in another order.
  EXPECT_LT(Difference(a, b), 1e-5);
  const Tensor weights = torch::randn_like(b);
  const auto grad_a = torch::autograd::grad({(a * weights).sum()}, leaves);
  const auto grad_b = torch::autograd::grad({(b * weights).sum()}, leaves);
  for (size_t i = 0; i < leaves.size(); ++i)
    EXPECT_LT(Difference(grad_a[i], grad_b[i]), 2e-5) << "leaf " << i;
}

Tensor RmsNorm(const Tensor& x, const Tensor& weight) {
  return x * torch::rsqrt(x.square().mean(-1, true) + 1e-6) * (1.0 + weight);
}

TEST(FusedOps, AddRmsNormEqualsItsFormulaAndGradients) {
  torch::manual_seed(1);
  const Tensor x = Leaf({3, 5, 37}), delta = Leaf({3, 5, 37}), weight = Leaf({37});
  ExpectSameValueAndGradients(
      {x, delta, weight},
      [&] {
        const auto [sum, y] = AddRmsNorm(x, delta, weight);
        return torch::cat({sum * 2.0, y});
      },
      [&] {
        return torch::cat({(x + delta) * 2.0, RmsNorm(x + delta, weight)});
      });
  ExpectSameValueAndGradients(
      {x, weight}, [&] { return AddRmsNorm(x, Tensor(), weight).second; },
      [&] { return RmsNorm(x, weight); });
}

TEST(FusedOps, GeGluEqualsItsFormulaAndGradients) {
  torch::manual_seed(2);
  const Tensor gate_up = Leaf({4, 7, 38});
  ExpectSameValueAndGradients(
      {gate_up}, [&] { return GeGlu(gate_up * 3.0); },
      [&] {
        const auto parts = (gate_up * 3.0).chunk(2, -1);
        return at::gelu(parts[0], "tanh") * parts[1];
      });
}

TEST(FusedOps, SplitRopeEqualsHalfSplitRotationAndGradients) {
  torch::manual_seed(3);
  const int64_t rows = 2, length = 5, heads = 3, h = 8;
  const Tensor qkv = Leaf({rows, length, (heads + 2) * h});
  const Tensor angle = torch::rand({20, h / 2}) * 6.0;
  const Tensor position = torch::randint(0, 20, {rows * length}, torch::kInt64);
  const auto plain = [&] {
    const auto parts = qkv.split_with_sizes({heads * h, h, h}, -1);
    const Tensor c = angle.cos().index_select(0, position).view({rows, length, 1, h / 2});
    const Tensor s = angle.sin().index_select(0, position).view({rows, length, 1, h / 2});
    const auto rotate = [&](const Tensor& x) {
      const auto half = x.chunk(2, -1);
      return torch::cat({half[0] * c - half[1] * s, half[1] * c + half[0] * s}, -1);
    };
    const Tensor q = rotate(parts[0].reshape({rows, length, heads, h})) * 0.3;
    const Tensor k = rotate(parts[1].reshape({rows, length, 1, h}));
    return torch::cat({q.flatten(), k.flatten(), parts[2].flatten()});
  };
  ExpectSameValueAndGradients(
      {qkv},
      [&] {
        const Heads out = SplitRope(qkv, angle.cos(), angle.sin(), position, heads, 0.3);
        return torch::cat({out.q.flatten(), out.k.flatten(), out.v.flatten()});
      },
      plain);
}

TEST(FusedOps, SoftmaxBiasEqualsMaskedSoftmaxAndGradients) {
  torch::manual_seed(4);
  const int64_t rows = 2, draws = 3, queries = 4, heads = 2, keys = 11;
  const Tensor scores = Leaf({rows * draws, queries * heads, keys});
  for (const int64_t bias_rows : {int64_t{1}, queries}) {
    const Tensor bias = torch::where(torch::rand({rows, bias_rows, keys}) < 0.3,
                                     torch::full({}, -2.3819763e38f), torch::zeros({}));
    ExpectSameValueAndGradients(
        {scores}, [&] { return SoftmaxBias(scores * 4.0, bias, heads); },
        [&] {
          const Tensor expanded = bias.view({rows, 1, bias_rows, 1, keys});
          return torch::softmax((scores * 4.0).view({rows, draws, queries, heads, keys}) + expanded,
                                -1)
              .view_as(scores);
        });
  }
}

TEST(FusedOps, MaskedScoresGetExactlyZeroAndAFullyMaskedRowStaysFinite) {
  const float masked = -2.3819763e38f;
  const Tensor bias = torch::tensor({0.0f, masked, 0.0f, masked, masked, masked}).view({1, 2, 3});
  const Tensor p =
      SoftmaxBias(torch::tensor({-90.0f, 90.0f, 5.0f, 1.0f, 2.0f, 3.0f}).view({1, 2, 3}), bias, 1);
  EXPECT_EQ(p[0][0][1].item<float>(), 0.0f);
  EXPECT_TRUE(torch::isfinite(p).all().item<bool>());
}

TEST(FusedOps, EveryInstructionSetGivesTheSameNumbers) {
#if defined(__x86_64__)
  if (!__builtin_cpu_supports("avx2") || !__builtin_cpu_supports("fma"))
    GTEST_SKIP() << "processor without AVX2";
  torch::manual_seed(5);
  const Tensor gate_up = torch::randn({6, 50}) * 5.0;
  Tensor a = torch::empty({6, 25}), b = torch::empty({6, 25});
  GenericFusedKernels().geglu(gate_up.data_ptr<float>(), 6, 25, a.data_ptr<float>());
  Avx2FusedKernels().geglu(gate_up.data_ptr<float>(), 6, 25, b.data_ptr<float>());
  EXPECT_LT(Difference(a, b),
            1e-6);  // fused multiply-add rounds once where the generic code rounds twice
#else
  GTEST_SKIP() << "one instruction set only";
#endif
}

}  // namespace
}  // namespace robostress
