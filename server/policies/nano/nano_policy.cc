#include "server/policies/nano/nano_policy.h"

#include <spdlog/spdlog.h>
#include <torch/types.h>

#include <cmath>
#include <cstring>
#include <mutex>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/check.h"
#include "common/status_macros.h"
#include "server/policies/guided_sampler.h"
#include "server/policies/nano/nano_network.h"
#include "server/policies/nano/nano_sampler.h"

namespace robostress {
namespace {

using torch::Tensor;

constexpr int kEulerSteps = 10;
constexpr float kStdEpsilon = 1e-6f;
constexpr size_t kToldInstructions = 1000;

class NanoPolicy : public FlowPolicy {
 public:
  NanoPolicy(NanoModel model, const std::string& model_hash, const std::string& name)
      : model_(std::move(model)),
        network_(model_.config, AssembleNano(model_.config, InferenceTensors(model_.tensors))),
        sampler_(model_.config, AssembleNano(model_.config, InferenceTensors(model_.tensors)),
                 EulerTimes(kEulerSteps)) {
    spec_.name = name;
    spec_.model_hash = model_hash;
    spec_.cameras = model_.config.cameras;
    spec_.image_width = spec_.image_height = spec_.max_view_side = model_.config.image_size;
    spec_.state_dim = model_.config.state_dim;
    spec_.action_dim = model_.config.action_dim;
    spec_.horizon = model_.config.horizon;
    spec_.execute_steps = model_.config.execute_steps;
    spec_.adaptable = spec_.inpaints = true;
    spec_.control_space =
        model_.config.displacement_channels > 0 ? ControlSpace::kJoint : ControlSpace::kEndEffector;
    // What demonstrations hold, and what the controller takes. Absolute joint targets have other
    // limits, the arm's, which weights do not know.
    if (model_.config.displacement_channels == 0) {
      spec_.action_low.assign(spec_.action_dim, -1.0f);
      spec_.action_high.assign(spec_.action_dim, 1.0f);
    }
  }

  const PolicySpec& spec() const override { return spec_; }
  int64_t horizon() const override { return model_.config.horizon; }
  int64_t model_action_dim() const override { return model_.config.model_action_dim; }
  const std::vector<LoraTarget>& lora_targets() const override { return network_.lora_targets(); }
  ContextShape context_shape() const override {
    const NanoConfig& c = model_.config;
    return {.layers = c.layers,
            .kv_heads = 1,
            .head_dim = c.head_dim,
            .max_prefix = c.prefix_tokens(),
            .state_dim = c.state_dim};
  }

  absl::StatusOr<PolicyContext> Encode(const Observation& observation) const override {
    try {
      torch::NoGradGuard no_grad;
      std::vector<Tensor> images;
      for (const std::string& camera : spec_.cameras) {
        RS_ASSIGN_OR_RETURN(Tensor image, EncodeView(observation, camera));
        images.push_back(std::move(image));
      }
      RS_ASSIGN_OR_RETURN(
          std::vector<int64_t> words,
          model_.vocabulary.Encode(observation.instruction, model_.config.max_words));
      TellUnknownWords(observation.instruction);
      RS_ASSIGN_OR_RETURN(Tensor state, EncodeState(observation.proprioception));
      const Tensor rows = torch::tensor(words, torch::kInt64).unsqueeze(0);
      return network_.EncodePrefix(images, rows, state, /*with_aux=*/false).context;
    } catch (
        const std::exception& error) {  // LibTorch reports out of memory and the like by throwing
      return absl::InternalError(absl::StrCat("nano: encoding failed: ", error.what()));
    }
  }

  Tensor Velocity(const PolicyContext& context, const Tensor& x_u, const Tensor& u,
                  const LoraWeights* lora) const override {
    return network_.Velocity(context, x_u, u, lora);
  }

  Tensor Sample(const PolicyContext& context, const Tensor& noise,
                const LoraWeights* lora) const override {
    return sampler_.Sample(context, noise, std::vector<const LoraWeights*>(noise.size(0), lora));
  }

  Tensor SampleRows(const PolicyContext& context, const Tensor& noise,
                    const std::vector<const LoraWeights*>& lora) const override {
    return sampler_.Sample(context, noise, lora);
  }

  Tensor Inpaint(const PolicyContext& context, const Tensor& noise, const LoraWeights* lora,
                 const RunningRows& running) const override {
    const int64_t horizon = model_.config.horizon, rows = running.actions.rows(),
                  dim = spec_.action_dim;
    Guidance guidance;
    guidance.rows = torch::zeros({horizon, model_.config.model_action_dim});
    guidance.rows.narrow(0, 0, rows)
        .narrow(1, 0, dim)
        .copy_(ToModel(running.actions, context.state));
    guidance.weight = torch::zeros_like(guidance.rows);  // of padding: none
    guidance.weight.narrow(1, 0, dim).copy_(
        SoftMask(running.held, rows, horizon).unsqueeze(1).expand({horizon, dim}));
    return SampleGuided(*this, context, noise, lora, EulerTimes(kEulerSteps), guidance);
  }

  Eigen::MatrixXf ToEnvironment(const Tensor& chunk, const Tensor& state) const override {
    const Tensor rows = chunk.to(torch::kFloat32).contiguous();
    const int dim = spec_.action_dim;
    RS_CHECK(rows.dim() == 2 && rows.size(1) >= dim);
    Eigen::MatrixXf actions(rows.size(0), dim);
    const auto values = rows.accessor<float, 2>();
    for (int i = 0; i < actions.rows(); ++i) {
      for (int j = 0; j < dim; ++j) {
        actions(i, j) =
            values[i][j] * (model_.actions.std[j] + kStdEpsilon) + model_.actions.mean[j];
      }
    }
    if (model_.config.displacement_channels > 0) actions.rowwise() += Origin(state);
    return actions;
  }

  Tensor ToModel(const Eigen::MatrixXf& absolute, const torch::Tensor& state) const override {
    RS_CHECK(absolute.cols() == spec_.action_dim);
    const Eigen::MatrixXf actions = absolute.rowwise() - Origin(state);
    Tensor rows = torch::empty({actions.rows(), actions.cols()});
    auto values = rows.accessor<float, 2>();
    for (int i = 0; i < actions.rows(); ++i) {
      for (int j = 0; j < actions.cols(); ++j) {
        values[i][j] =
            (actions(i, j) - model_.actions.mean[j]) / (model_.actions.std[j] + kStdEpsilon);
      }
    }
    return rows;
  }

 private:
  // Once an instruction; of a client that sends ever new ones no more than kToldInstructions.
  void TellUnknownWords(const std::string& instruction) const {
    const std::vector<std::string> unknown = model_.vocabulary.Unknown(instruction);
    if (unknown.empty()) return;
    const std::lock_guard<std::mutex> lock(told_mutex_);
    if (told_.size() >= kToldInstructions || !told_.insert(instruction).second) return;
    spdlog::warn("{} never learned these words of '{}', all are one to it: {}", spec_.name,
                 absl::StrJoin(SplitWords(instruction), " "), absl::StrJoin(unknown, ", "));
  }

  // What the network's actions are counted from [action_dim]: the state of the chunk's prediction
  // in the channels that are displacements, 0 in the others.
  Eigen::RowVectorXf Origin(const Tensor& state) const {
    Eigen::RowVectorXf origin = Eigen::RowVectorXf::Zero(spec_.action_dim);
    if (model_.config.displacement_channels == 0) return origin;
    const Tensor row = state.to(torch::kFloat32).reshape({-1}).contiguous();
    RS_CHECK(row.size(0) == spec_.state_dim);
    for (int j = 0; j < model_.config.displacement_channels; ++j) {
      origin[j] =
          row.data_ptr<float>()[j] * (model_.state.std[j] + kStdEpsilon) + model_.state.mean[j];
    }
    return origin;
  }
  static std::vector<Tensor> InferenceTensors(const std::vector<Tensor>& tensors) {
    std::vector<Tensor> copies;
    for (const Tensor& tensor : tensors) {
      const Tensor detached = tensor.detach();
      copies.push_back(detached.dim() == 4 ? detached.contiguous(at::MemoryFormat::ChannelsLast)
                                           : detached);
    }
    return copies;
  }

  absl::StatusOr<Tensor> EncodeView(const Observation& observation,
                                    const std::string& camera) const {
    const int size = model_.config.image_size;
    std::vector<std::string> given;
    for (const CameraView& view : observation.views) {
      given.push_back(view.camera);
      if (view.camera != camera) continue;
      const Image& image = view.image;
      if (image.width != size || image.height != size) {
        return absl::InvalidArgumentError(absl::StrCat(
            "image of camera '", camera, "' is ", image.width, " x ", image.height, ", nano takes ",
            size, " x ", size, "; render at the size that the policy declares"));
      }
      const size_t bytes = size_t{3} * size * size;
      if (image.data.size() != bytes) {
        return absl::InvalidArgumentError(absl::StrCat(
            "image of camera '", camera, "' has ", image.data.size(), " bytes, must have ", bytes));
      }
      Tensor pixels = torch::empty({1, size, size, 3}, torch::kUInt8);
      std::memcpy(pixels.data_ptr<uint8_t>(), image.data.data(), bytes);
      return pixels.to(torch::kFloat32).div_(127.5f).sub_(1.0f).permute({0, 3, 1, 2});
    }
    return absl::InvalidArgumentError(absl::StrCat(
        "no image of camera '", camera,
        "', which nano needs; given: ", given.empty() ? "none" : absl::StrJoin(given, ", ")));
  }

  absl::StatusOr<Tensor> EncodeState(const Eigen::VectorXf& state) const {
    if (state.size() != spec_.state_dim) {
      return absl::InvalidArgumentError(absl::StrCat("proprioception has ", state.size(),
                                                     " numbers, nano takes ", spec_.state_dim));
    }
    Tensor row = torch::empty({1, spec_.state_dim});
    for (int i = 0; i < spec_.state_dim; ++i) {
      if (!std::isfinite(state[i])) {
        return absl::InvalidArgumentError(
            absl::StrCat("proprioception[", i, "] is ", state[i], ", must be finite"));
      }
      row.data_ptr<float>()[i] =
          (state[i] - model_.state.mean[i]) / (model_.state.std[i] + kStdEpsilon);
    }
    return row;
  }

  NanoModel model_;
  NanoNetwork network_;  // the prefix, and the velocity where gradients are wanted
  NanoSampler sampler_;  // predictions
  PolicySpec spec_;
  mutable std::mutex told_mutex_;
  mutable std::set<std::string> told_;
};

}  // namespace

std::vector<float> EulerTimes(int steps) {
  std::vector<float> times;
  const float dt = -1.0f / static_cast<float>(steps);
  for (float t = 1.0f; t >= -dt / 2; t += dt) times.push_back(t);
  return times;
}

absl::StatusOr<std::unique_ptr<FlowPolicy>> MakeNanoPolicy(NanoModel model,
                                                           const std::string& model_hash,
                                                           const std::string& name) {
  try {
    return std::make_unique<NanoPolicy>(std::move(model), model_hash, name);
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat("nano: the network cannot be built: ", error.what()));
  }
}

}  // namespace robostress
