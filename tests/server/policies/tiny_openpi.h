#pragma once

#include <torch/cuda.h>
#include <torch/types.h>

#include <filesystem>
#include <map>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/safetensors.h"
#include "server/policies/openpi/oracle_inputs.h"

// pi0 and pi0.5 in the size of a thumb, and files in the form that policy check reads.
namespace robostress::openpi {

// Where a policy may compute here: a GPU too where there is one.
inline std::vector<std::string> Devices() {
  std::vector<std::string> devices = {"cpu"};
  if (torch::cuda::is_available()) devices.push_back("cuda");
  return devices;
}

// No two sizes are equal, so that a mistaken one shows.
inline OpenpiConfig TinyConfig(bool pi05) {
  OpenpiConfig c;
  c.pi05 = pi05;
  c.image = 15, c.patch = 5;
  c.vision_width = 12, c.vision_depth = 2, c.vision_heads = 3, c.vision_mlp = 20;
  c.prefix_width = 28, c.prefix_mlp = 36, c.expert_width = 16, c.expert_mlp = 24;
  c.depth = 3, c.heads = 6, c.kv_heads = 2, c.head_dim = 8;
  c.vocab = 31, c.horizon = 7, c.action_dim = 10, c.prompt_tokens = 11, c.state_dim = 4;
  return c;
}

inline std::string ConfigJson(const OpenpiConfig& c) {
  const nlohmann::json json = {
      {"pi05", c.pi05},          {"image", c.image},       {"patch", c.patch},
      {"vw", c.vision_width},    {"vd", c.vision_depth},   {"vh", c.vision_heads},
      {"vm", c.vision_mlp},      {"pw", c.prefix_width},   {"pm", c.prefix_mlp},
      {"ew", c.expert_width},    {"em", c.expert_mlp},     {"depth", c.depth},
      {"heads", c.heads},        {"kv_heads", c.kv_heads}, {"hd", c.head_dim},
      {"vocab", c.vocab},        {"horizon", c.horizon},   {"adim", c.action_dim},
      {"tlen", c.prompt_tokens}, {"sdim", c.state_dim}};
  return json.dump();
}

// Random inputs; with `padded`, some cameras (the first too) are absent and prompts have padding.
inline OracleInputs RandomInputs(const OpenpiConfig& c, int64_t batch, int64_t cameras, bool padded,
                                 uint64_t seed) {
  torch::manual_seed(seed);
  OracleInputs inputs;
  const std::vector<std::string> names = {"base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb",
                                          "a_fourth"};
  for (int64_t i = 0; i < cameras; ++i) {
    inputs.cameras.push_back(names[i]);
    inputs.model.images.push_back(at::rand({batch, 3, c.image, c.image}) * 2 - 1);
    inputs.model.image_masks.push_back(padded
                                           ? (at::arange(batch) + i).remainder(2).to(torch::kBool)
                                           : at::ones({batch}, torch::kBool));
  }
  inputs.model.tokens = at::randint(c.vocab, {batch, c.prompt_tokens}, torch::kInt64);
  const torch::Tensor lengths =
      padded ? at::arange(batch).unsqueeze(1) * 3 + 2 : at::full({batch, 1}, c.prompt_tokens);
  inputs.model.token_mask = at::arange(c.prompt_tokens).unsqueeze(0) < lengths;
  inputs.model.state = at::randn({batch, c.action_dim});
  inputs.noise = at::randn({batch, c.horizon, c.action_dim});
  inputs.loss_actions = at::randn_like(inputs.noise);
  inputs.loss_noise = at::randn_like(inputs.noise);
  inputs.loss_time = at::rand({batch}) * 0.9 + 0.05;
  return inputs;
}

// Tensors of a file by name.
using TensorMap = std::map<std::string, torch::Tensor>;

inline TensorMap WeightTensors(OpenpiModel model) {
  struct : ParameterVisitor {
    void OnTensor(const std::string& name, const std::vector<int64_t>&,
                  torch::Tensor& tensor) override {
      tensors[name] = tensor;
    }
    TensorMap tensors;
  } collect;
  VisitParameters(model.config, model.weights, collect);
  return collect.tensors;
}

inline TensorMap InputTensors(const OracleInputs& inputs) {
  TensorMap tensors = {
      {"inputs/tokens", inputs.model.tokens},       {"inputs/token_mask", inputs.model.token_mask},
      {"inputs/state", inputs.model.state},         {"inputs/noise", inputs.noise},
      {"inputs/loss.actions", inputs.loss_actions}, {"inputs/loss.noise", inputs.loss_noise},
      {"inputs/loss.time", inputs.loss_time}};
  for (size_t i = 0; i < inputs.cameras.size(); ++i) {
    tensors["inputs/image." + inputs.cameras[i]] = inputs.model.images[i];
    tensors["inputs/image_mask." + inputs.cameras[i]] = inputs.model.image_masks[i];
  }
  return tensors;
}

inline DType StoredAs(c10::ScalarType type) {
  switch (type) {
    case torch::kBool:
      return DType::kBool;
    case torch::kInt64:
      return DType::kI64;
    case torch::kFloat16:
      return DType::kF16;
    case torch::kBFloat16:
      return DType::kBF16;
    case torch::kFloat64:
      return DType::kF64;
    default:
      return DType::kF32;
  }
}

// Writes NAME into the tests' folder and returns its path.
inline std::string WriteTensors(const std::string& name, const TensorMap& tensors,
                                const std::map<std::string, std::string>& metadata) {
  SafetensorsWriter writer;
  for (const auto& [key, value] : metadata) writer.SetMetadata(key, value);
  for (const auto& [key, tensor] : tensors) {
    const torch::Tensor dense = tensor.detach().contiguous();
    writer.Add(key, StoredAs(dense.scalar_type()), dense.sizes().vec(), dense.data_ptr(),
               dense.nbytes());
  }
  const std::string path = (std::filesystem::path(::testing::TempDir()) / name).string();
  const absl::Status status = writer.Write(path);
  EXPECT_TRUE(status.ok()) << status;
  return path;
}

}  // namespace robostress::openpi
