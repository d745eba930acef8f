#include "server/policies/openpi/preprocessor.h"

#include <spdlog/spdlog.h>
#include <torch/types.h>

#include <cmath>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/check.h"
#include "common/status_macros.h"
#include "server/policies/openpi/images.h"

namespace robostress::openpi {
namespace {

Eigen::MatrixXd ToMatrix(const torch::Tensor& rows) {
  const torch::Tensor dense = rows.to(torch::kFloat32).contiguous();
  RS_CHECK(dense.dim() == 2);
  using RowMajor = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  return Eigen::Map<const RowMajor>(dense.data_ptr<float>(), dense.size(0), dense.size(1))
      .cast<double>();
}

torch::Tensor ToRows(const Eigen::MatrixXd& matrix) {
  torch::Tensor rows = at::empty({matrix.rows(), matrix.cols()});
  using RowMajor = Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
  Eigen::Map<RowMajor>(rows.data_ptr<float>(), matrix.rows(), matrix.cols()) = matrix.cast<float>();
  return rows;
}

}  // namespace

absl::StatusOr<std::unique_ptr<const Preprocessor>> Preprocessor::Create(
    PolicySetup setup, const OpenpiConfig& config) {
  RS_ASSIGN_OR_RETURN(std::unique_ptr<Tokenizer> tokenizer, Tokenizer::Load(setup.tokenizer));
  RS_RETURN_IF_ERROR(CheckPieces(*tokenizer, config.vocab));
  return std::unique_ptr<const Preprocessor>(
      new Preprocessor(std::move(setup), config, std::move(tokenizer)));
}

absl::StatusOr<torch::Tensor> Preprocessor::PrepareView(const Observation& observation,
                                                        const std::string& camera) const {
  std::vector<std::string> given;
  for (const CameraView& view : observation.views) {
    given.push_back(view.camera);
    if (view.camera != camera) continue;
    const Image& image = view.image;
    if (image.width < 1 || image.height < 1 ||
        image.data.size() != size_t{3} * image.width * image.height) {
      return absl::InvalidArgumentError(
          absl::StrCat("image of camera '", camera, "' is ", image.width, " x ", image.height,
                       " and has ", image.data.size(), " bytes, must have 3 per pixel"));
    }
    return ImageTensor(image, config_.image, setup_.resize);
  }
  return absl::InvalidArgumentError(absl::StrCat(
      "no image of camera '", camera,
      "', which the policy needs; given: ", given.empty() ? "none" : absl::StrJoin(given, ", ")));
}

absl::StatusOr<Eigen::MatrixXd> Preprocessor::PrepareState(const Observation& observation) const {
  const Eigen::VectorXf& state = observation.proprioception;
  if (state.size() != setup_.robot.state_dim) {
    return absl::InvalidArgumentError(absl::StrCat("proprioception has ", state.size(),
                                                   " numbers, transform ", setup_.robot.name,
                                                   " takes ", setup_.robot.state_dim));
  }
  for (Eigen::Index i = 0; i < state.size(); ++i) {
    if (!std::isfinite(state[i])) {
      return absl::InvalidArgumentError(
          absl::StrCat("proprioception[", i, "] is ", state[i], ", must be finite"));
    }
  }
  return setup_.state.Normalise(state.transpose().cast<double>());
}

absl::StatusOr<ModelInputs> Preprocessor::Prepare(const Observation& observation) const {
  ModelInputs inputs;
  for (const std::string& camera : setup_.robot.cameras) {
    if (camera.empty()) continue;
    RS_ASSIGN_OR_RETURN(torch::Tensor image, PrepareView(observation, camera));
    inputs.images.push_back(std::move(image));
    inputs.image_masks.push_back(at::ones({1}, torch::kBool));
  }
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXd state, PrepareState(observation));
  Eigen::MatrixXd padded = Eigen::MatrixXd::Zero(1, config_.action_dim);
  padded.leftCols(state.cols()) = state;
  inputs.state = ToRows(padded);

  const Eigen::MatrixXd& shown = setup_.prompt_has_padded_state ? padded : state;
  RS_ASSIGN_OR_RETURN(
      const Prompt prompt,
      MakePrompt(*tokenizer_, setup_.prompt, setup_.prompt_tokens, observation.instruction,
                 absl::MakeConstSpan(shown.data(), static_cast<size_t>(shown.size()))));
  if (prompt.cut > 0) {
    spdlog::warn("prompt has {} tokens, {} are cut off; its length is prompt_tokens = {}",
                 prompt.used + prompt.cut, prompt.cut, setup_.prompt_tokens);
  }
  inputs.tokens = torch::tensor(prompt.ids, torch::kInt64).unsqueeze(0);
  inputs.token_mask = (at::arange(setup_.prompt_tokens) < prompt.used).unsqueeze(0);
  return inputs;
}

Eigen::VectorXd Preprocessor::StateOf(const torch::Tensor& normalised) const {
  const Eigen::MatrixXd rows = ToMatrix(normalised.reshape({1, -1}));
  return setup_.state.Unnormalise(rows.leftCols(setup_.robot.state_dim)).row(0).transpose();
}

Eigen::MatrixXf Preprocessor::ToEnvironment(const torch::Tensor& chunk,
                                            const torch::Tensor& state) const {
  Eigen::MatrixXd actions =
      setup_.actions.Unnormalise(ToMatrix(chunk).leftCols(setup_.robot.action_dim));
  if (setup_.delta) DeltaToAbsolute(StateOf(state), setup_.robot.delta_dims, actions);
  return actions.cast<float>();
}

torch::Tensor Preprocessor::ToModel(const Eigen::MatrixXf& actions,
                                    const torch::Tensor& state) const {
  RS_CHECK(actions.cols() == setup_.robot.action_dim);
  Eigen::MatrixXd rows = actions.cast<double>();
  if (setup_.delta) AbsoluteToDelta(StateOf(state), setup_.robot.delta_dims, rows);
  return ToRows(setup_.actions.Normalise(rows));
}

}  // namespace robostress::openpi
