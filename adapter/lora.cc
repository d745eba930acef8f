#include "adapter/lora.h"

#include <torch/types.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <numeric>

#include "common/check.h"

namespace robostress {

const char* LoraKindName(LoraKind kind) {
  return kind == LoraKind::kPerHead ? "per_head" : "per_matrix";
}

LoraShape LoraShapeOf(const LoraTarget& target, LoraKind kind, int64_t rank) {
  const int64_t in = target.in_features, out = target.out_features;
  RS_CHECK(target.output_heads == 1 || target.input_heads == 1);
  if (kind == LoraKind::kPerHead && target.output_heads > 1)
    return {{target.output_heads, rank, in},
            {target.output_heads, out / target.output_heads, rank}};
  if (kind == LoraKind::kPerHead && target.input_heads > 1)
    return {{target.input_heads, rank, in / target.input_heads}, {target.input_heads, out, rank}};
  return {{rank, in}, {out, rank}};
}

int64_t NumLoraParameters(const std::vector<LoraTarget>& targets, LoraKind kind, int64_t rank) {
  const auto product = [](const std::vector<int64_t>& sizes) {
    return std::accumulate(sizes.begin(), sizes.end(), int64_t{1}, std::multiplies<>());
  };
  int64_t count = 0;
  for (const LoraTarget& target : targets) {
    const LoraShape shape = LoraShapeOf(target, kind, rank);
    count += product(shape.A) + product(shape.B);
  }
  return count;
}

LoraWeights InitialLora(const std::vector<LoraTarget>& targets, LoraKind kind, int64_t rank,
                        double init_std, const StreamKey& session) {
  LoraWeights lora;
  for (const LoraTarget& target : targets) {
    const LoraShape shape = LoraShapeOf(target, kind, rank);
    RandomStream stream(session.With("lora_init").With(target.name));
    torch::Tensor A = torch::empty(shape.A, torch::kFloat32);
    float* values = A.data_ptr<float>();
    for (int64_t i = 0; i < A.numel(); ++i)
      values[i] = static_cast<float>(init_std * stream.Normal());
    lora.A.push_back(A);
    lora.B.push_back(torch::zeros(shape.B, torch::kFloat32));
  }
  return lora;
}

torch::Tensor LoraDelta(const torch::Tensor& x, const torch::Tensor& A, const torch::Tensor& B) {
  if (A.dim() == 2) return torch::linear(torch::linear(x, A), B);
  const int64_t heads = A.size(0), rank = A.size(1), in = x.size(-1), rows = x.numel() / in;
  std::vector<int64_t> shape = x.sizes().vec();
  torch::Tensor y;
  if (A.size(2) == in) {  // a head's part of the outputs each
    const torch::Tensor low = torch::linear(x, A.flatten(0, 1)).view({rows, heads, rank});
    y = torch::bmm(low.transpose(0, 1), B.transpose(1, 2)).transpose(0, 1);  // [rows, heads, out]
  } else {  // a head's part of the inputs each; the sum over heads is one product
    const torch::Tensor parts = x.reshape({rows, heads, in / heads}).transpose(0, 1);
    const torch::Tensor low = torch::bmm(parts, A.transpose(1, 2)).transpose(0, 1).flatten(1);
    y = torch::linear(low, B.transpose(0, 1).flatten(1));
  }
  shape.back() = y.numel() / rows;
  return y.reshape(shape);
}

MatrixPair AsMatrices(const LoraTarget& target, const torch::Tensor& A, const torch::Tensor& B) {
  if (A.dim() == 2) return {A, B};
  const int64_t heads = A.size(0), rank = A.size(1);
  if (target.output_heads > 1) {
    const int64_t size = B.size(1);
    torch::Tensor blocks = torch::zeros({target.out_features, heads * rank}, B.options());
    for (int64_t n = 0; n < heads; ++n)
      blocks.narrow(0, n * size, size).narrow(1, n * rank, rank).copy_(B[n]);
    return {A.flatten(0, 1), blocks};
  }
  const int64_t size = A.size(2);
  torch::Tensor blocks = torch::zeros({heads * rank, target.in_features}, A.options());
  for (int64_t n = 0; n < heads; ++n)
    blocks.narrow(0, n * rank, rank).narrow(1, n * size, size).copy_(A[n]);
  return {blocks, B.transpose(0, 1).flatten(1)};
}

LoraRows StackLora(const std::vector<LoraTarget>& targets,
                   const std::vector<const LoraWeights*>& rows) {
  torch::NoGradGuard no_grad;
  const auto count = static_cast<int64_t>(rows.size());
  LoraRows result;
  for (size_t i = 0; i < targets.size(); ++i) {
    std::vector<MatrixPair> pairs(rows.size());
    int64_t rank = 1;
    for (size_t row = 0; row < rows.size(); ++row) {
      if (rows[row] == nullptr) continue;
      pairs[row] = AsMatrices(targets[i], rows[row]->A[i], rows[row]->B[i]);
      rank = std::max(rank, pairs[row].A.size(0));
    }
    torch::Tensor A = torch::zeros({count, rank, targets[i].in_features});
    torch::Tensor B = torch::zeros({count, targets[i].out_features, rank});
    for (int64_t row = 0; row < count; ++row) {
      const MatrixPair& pair = pairs[row];
      if (!pair.A.defined()) continue;
      A[row].narrow(0, 0, pair.A.size(0)).copy_(pair.A);
      B[row].narrow(1, 0, pair.A.size(0)).copy_(pair.B);
    }
    result.A.push_back(A);
    result.B.push_back(B);
  }
  return result;
}

torch::Tensor LoraRowsDelta(const torch::Tensor& x, const torch::Tensor& A,
                            const torch::Tensor& B) {
  return torch::bmm(torch::bmm(x, A.transpose(1, 2)), B.transpose(1, 2));
}

std::vector<torch::Tensor> Parameters(const LoraWeights& lora) {
  RS_CHECK(lora.A.size() == lora.B.size());
  std::vector<torch::Tensor> parameters;
  for (size_t i = 0; i < lora.A.size(); ++i) {
    parameters.push_back(lora.A[i]);
    parameters.push_back(lora.B[i]);
  }
  return parameters;
}

LoraWeights FromParameters(const std::vector<torch::Tensor>& parameters, uint64_t version) {
  RS_CHECK(parameters.size() % 2 == 0);
  LoraWeights lora;
  lora.version = version;
  for (size_t i = 0; i < parameters.size(); i += 2) {
    lora.A.push_back(parameters[i]);
    lora.B.push_back(parameters[i + 1]);
  }
  return lora;
}

double LoraDistance(const LoraWeights& phi, const LoraWeights& phi_0) {
  const std::vector<torch::Tensor> a = Parameters(phi), b = Parameters(phi_0);
  RS_CHECK(a.size() == b.size());
  double sum = 0;
  for (size_t i = 0; i < a.size(); ++i) {
    sum += (a[i] - b[i]).to(torch::kFloat64).square().sum().item<double>();
  }
  return std::sqrt(sum);
}

int64_t NumParameters(const LoraWeights& lora) {
  int64_t count = 0;
  for (const torch::Tensor& parameter : Parameters(lora)) count += parameter.numel();
  return count;
}

}  // namespace robostress
