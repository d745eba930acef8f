#include "server/policies/openpi/precision.h"

#include <torch/torch.h>

#include "absl/strings/match.h"

namespace robostress::openpi {
namespace {

// openpi keeps these in float32: its list of names, and what lies outside of both towers.
bool StaysFloat32(const std::string& name) {
  if (!absl::StartsWith(name, "paligemma_with_expert.")) return true;
  for (const char* part :
       {"patch_embedding", "position_embedding", "input_layernorm", "post_attention_layernorm",
        "language_model.norm", "expert.model.norm"}) {
    if (absl::StrContains(name, part)) return true;
  }
  return false;
}

struct ConvertVisitor : ParameterVisitor {
  ConvertVisitor(const Dtypes& d, const torch::Device& on) : dtypes(d), device(on) {}
  void OnTensor(const std::string& name, const std::vector<int64_t>& shape,
                torch::Tensor& tensor) override {
    if (StaysFloat32(name)) {
      tensor = tensor.to(device, torch::kFloat32);
    } else if (shape.size() > 1) {
      tensor = tensor.to(device, dtypes.matrices);
    } else {
      tensor = tensor.to(device, dtypes.matrices).to(dtypes.activations);
    }
  }
  void OnLinear(const std::string& name, int64_t in, int64_t out, bool bias,
                Linear& linear) override {
    ParameterVisitor::OnLinear(name, in, out, bias, linear);
    if (!linear.lora_A.defined()) return;
    linear.lora_A = linear.lora_A.to(device);
    linear.lora_B = linear.lora_B.to(device);
  }
  Dtypes dtypes;
  torch::Device device;
};

}  // namespace

bool MultipliesBf16(const torch::Device& device) {
  if (device.is_cuda()) return true;
#if defined(__x86_64__)
  return __builtin_cpu_supports("avx512bf16") || __builtin_cpu_supports("amx-bf16");
#else
  return false;
#endif
}

OpenpiModel ConvertModel(OpenpiModel model, const Dtypes& dtypes, const torch::Device& device) {
  ConvertVisitor convert(dtypes, device);
  VisitParameters(model.config, model.weights, convert);
  return model;
}

}  // namespace robostress::openpi
