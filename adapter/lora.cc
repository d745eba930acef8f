#include "adapter/lora.h"

#include <torch/torch.h>

#include <cmath>

#include "common/check.h"

namespace robostress {

LoraWeights InitialLora(const std::vector<LoraTarget>& targets, int64_t rank, double init_std,
                        const StreamKey& session) {
  LoraWeights lora;
  for (const LoraTarget& target : targets) {
    RandomStream stream(session.With("lora_init").With(target.name));
    torch::Tensor A = torch::empty({rank, target.in_features}, torch::kFloat32);
    float* values = A.data_ptr<float>();
    for (int64_t i = 0; i < A.numel(); ++i)
      values[i] = static_cast<float>(init_std * stream.Normal());
    lora.A.push_back(A);
    lora.B.push_back(torch::zeros({target.out_features, rank}, torch::kFloat32));
  }
  return lora;
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
