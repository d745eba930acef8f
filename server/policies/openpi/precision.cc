#include "server/policies/openpi/precision.h"

#include <torch/cuda.h>
#include <torch/types.h>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

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

struct WidenExpert : ParameterVisitor {
  void OnTensor(const std::string& name, const std::vector<int64_t>&,
                torch::Tensor& tensor) override {
    if (absl::StartsWith(name, "paligemma_with_expert.gemma_expert."))
      tensor = tensor.to(torch::kFloat32);
  }
};

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

absl::StatusOr<torch::Device> FindDevice(const std::string& name) {
  torch::Device device = torch::kCPU;
  try {
    device = torch::Device(name);
  } catch (const std::exception&) {
    return absl::InvalidArgumentError(
        absl::StrCat("device '", name, "' must be cpu, cuda or cuda:N"));
  }
  if (device.is_cpu()) return device;
  if (!device.is_cuda() || !at::hasCUDA()) {
    return absl::FailedPreconditionError(absl::StrCat(
        "device '", name, "' is not there: this LibTorch was built without it; use cpu"));
  }
  const auto count = static_cast<int64_t>(torch::cuda::device_count());
  if (!device.has_index()) device.set_index(0);
  if (device.index() >= count) {
    return absl::FailedPreconditionError(
        absl::StrCat("device '", name, "' is not there: LibTorch sees ", count, " GPUs; use cpu"));
  }
  return device;
}

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

OpenpiModel WithFloat32Expert(OpenpiModel model) {
  WidenExpert widen;
  VisitParameters(model.config, model.weights, widen);
  return model;
}

}  // namespace robostress::openpi
