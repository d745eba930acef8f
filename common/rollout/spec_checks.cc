#include "common/rollout/spec_checks.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/rollout/field_checks.h"
#include "common/rollout/message_limits.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

std::string MatrixSize(const Eigen::MatrixXf& m) { return absl::StrCat(m.rows(), " x ", m.cols()); }

}  // namespace

absl::Status CheckMatrixSize(const std::string& field, const Eigen::MatrixXf& matrix, int rows,
                             int cols) {
  if (matrix.rows() == rows && matrix.cols() == cols) return absl::OkStatus();
  return Invalid(field, " is ", MatrixSize(matrix), ", must be ", rows, " x ", cols);
}

absl::Status CheckScales(const SessionSetting& spec) {
  const std::pair<const char*, double> scales[] = {
      {"spec.control_period_s", spec.control_period_s},
      {"spec.translation_scale", spec.translation_scale},
      {"spec.rotation_scale", spec.rotation_scale}};
  for (const auto& [field, value] : scales) {
    if (value >= 1e-6 && value <= 100) continue;
    return Invalid(field, " is ", value, ", must be 1e-6..100");
  }
  return absl::OkStatus();
}

absl::Status CheckSessionSpec(const SessionSetting& spec) {
  RS_RETURN_IF_ERROR(CheckName("spec.robot", spec.robot));
  RS_RETURN_IF_ERROR(CheckName("spec.suite", spec.suite));
  RS_RETURN_IF_ERROR(CheckName("spec.scenario", spec.scenario));
  RS_RETURN_IF_ERROR(CheckName("spec.policy", spec.policy));
  RS_RETURN_IF_ERROR(CheckRange("spec.severity", static_cast<uint64_t>(spec.severity), 1, 5));
  return CheckScales(spec);
}

absl::Status CheckActionRange(const PolicySpec& spec) {
  if (spec.action_low.empty() && spec.action_high.empty()) return absl::OkStatus();
  const auto dims = static_cast<size_t>(spec.action_dim);
  if (spec.action_low.size() != dims || spec.action_high.size() != dims) {
    return Invalid("policy.action_low has ", spec.action_low.size(), " and action_high ",
                   spec.action_high.size(), " values; give ", spec.action_dim, " each or none");
  }
  for (size_t i = 0; i < dims; ++i) {
    const float low = spec.action_low[i], high = spec.action_high[i];
    if (std::isfinite(low) && std::isfinite(high) && low <= high) continue;
    return Invalid("policy.action_low[", i, "] is ", low, " and action_high[", i, "] ", high,
                   "; they must be finite and in this order");
  }
  return absl::OkStatus();
}

absl::Status CheckObservation(const Observation& observation, const PolicySpec& spec) {
  RS_RETURN_IF_ERROR(CheckUtf8("instruction", observation.instruction));
  std::vector<std::string> cameras;
  for (const CameraView& view : observation.views) cameras.push_back(view.camera);
  if (cameras != spec.cameras) {
    return Invalid("observation has the views [", absl::StrJoin(cameras, ", "), "], policy '",
                   spec.name, "' wants [", absl::StrJoin(spec.cameras, ", "), "] in this order");
  }
  const int limit = std::max({spec.max_view_side, spec.image_width, spec.image_height});
  for (const CameraView& view : observation.views) {
    const int width = view.image.width, height = view.image.height;
    if (std::max(width, height) > limit) {
      return Invalid("view '", view.camera, "' is ", width, " x ", height, " px, at most ", limit,
                     " a side; policy '", spec.name, "' computes with ", spec.image_width, " x ",
                     spec.image_height);
    }
  }
  if (observation.proprioception.size() != spec.state_dim) {
    return Invalid("proprioception has ", observation.proprioception.size(), " values, policy '",
                   spec.name, "' wants ", spec.state_dim);
  }
  return absl::OkStatus();
}

absl::Status CheckRunningRows(const RunningRows& running, const PolicySpec& spec) {
  if (!spec.inpaints) return InpaintingError(spec.name);
  const auto rows = static_cast<int>(running.actions.rows());
  if (rows < 1 || rows > spec.horizon || running.actions.cols() != spec.action_dim) {
    return Invalid("running.actions is ", MatrixSize(running.actions), ", policy '", spec.name,
                   "' takes 1 to ", spec.horizon, " rows x ", spec.action_dim);
  }
  if (running.held < 0 || running.held > rows) {
    return Invalid("running.held is ", running.held, ", must be 0 to the ", rows,
                   " rows of running.actions");
  }
  for (int i = 0; i < rows; ++i) {
    for (int j = 0; j < spec.action_dim; ++j) {
      const float value = running.actions(i, j);
      if (std::abs(value) <= WireLimits::kWidestAction) continue;  // false of what is no number
      return Invalid("running.actions[", i, ",", j, "] is ", value, ", must be within +-",
                     WireLimits::kWidestAction);
    }
  }
  return absl::OkStatus();
}

absl::Status CheckPrediction(const PredictedChunk& prediction, const PolicySpec& spec) {
  RS_RETURN_IF_ERROR(CheckMatrixSize("actions", prediction.actions, spec.horizon, spec.action_dim));
  RS_RETURN_IF_ERROR(
      CheckMatrixSize("policy_actions", prediction.policy_actions, spec.horizon, spec.action_dim));
  if (prediction.base_actions.size() > 0) {
    RS_RETURN_IF_ERROR(
        CheckMatrixSize("base_actions", prediction.base_actions, spec.horizon, spec.action_dim));
  }
  for (const Eigen::MatrixXf* matrix :
       {&prediction.actions, &prediction.policy_actions, &prediction.base_actions}) {
    if (!matrix->allFinite())
      return Invalid("policy '", spec.name, "' predicted an action that is not finite");
  }
  return absl::OkStatus();
}

absl::Status CheckExecutable(const PredictedChunk& prediction, const PolicySpec& spec) {
  const auto fits = [&](const Eigen::MatrixXf& m) {
    return m.rows() >= spec.execute_steps && m.cols() == spec.action_dim;
  };
  if (fits(prediction.actions) && fits(prediction.policy_actions) &&
      (prediction.base_actions.size() == 0 || fits(prediction.base_actions))) {
    return absl::OkStatus();
  }
  return absl::InternalError(absl::StrCat("policy '", spec.name, "' predicted ",
                                          prediction.actions.rows(), " x ",
                                          prediction.actions.cols(), " actions, needs at least ",
                                          spec.execute_steps, " x ", spec.action_dim));
}

absl::Status CheckExecutedChunk(const ExecutedChunk& chunk, const PolicySpec& spec) {
  const int n = static_cast<int>(chunk.steps.size());
  if (n < 1) return Invalid("executed chunk ", chunk.sequence, " has no steps");
  if (chunk.first_step < 0 || chunk.first_step + n > spec.horizon) {
    return Invalid("executed chunk ", chunk.sequence, " covers steps ", chunk.first_step, " to ",
                   chunk.first_step + n - 1, ", policy '", spec.name, "' predicts ", spec.horizon);
  }
  if (!chunk.masked.empty() && chunk.masked.size() != chunk.steps.size()) {
    return Invalid("executed chunk ", chunk.sequence, " has ", chunk.masked.size(),
                   " mask values for ", n, " steps; give one per step or none");
  }
  const bool has_base = chunk.steps[0].base_command.size() > 0;
  for (int i = 0; i < n; ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const std::pair<const char*, const Eigen::VectorXf*> commands[] = {
        {"policy_command", &step.policy_command},
        {"sent_command", &step.sent_command},
        {"base_command", &step.base_command}};
    for (const auto& [field, command] : commands) {
      if (command == &step.base_command && !has_base && command->size() == 0) continue;
      if (command->size() != spec.action_dim) {
        return Invalid("executed chunk ", chunk.sequence, ", step ", i, ": ", field, " has ",
                       command->size(), " values, must have ", spec.action_dim);
      }
    }
  }
  return absl::OkStatus();
}

}  // namespace robostress
