#include "adapter/residual.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/check.h"
#include "common/so3.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr double kUnitQuaternionTolerance = 1e-3;

// `what` says whose values they are; asked for an error only.
template <class Values, class What>
absl::Status CheckFinite(const Values& values, const What& what) {
  for (Eigen::Index i = 0; i < values.size(); ++i) {
    if (!std::isfinite(values[i])) {
      return absl::InvalidArgumentError(
          absl::StrCat(what(), "[", i, "] is ", values[i], "; it must be finite"));
    }
  }
  return absl::OkStatus();
}

template <class What>
absl::Status CheckState(const RobotState& state, const What& what) {
  RS_RETURN_IF_ERROR(CheckFinite(state.q, [&] { return what() + ".q"; }));
  RS_RETURN_IF_ERROR(CheckFinite(state.dq, [&] { return what() + ".dq"; }));
  RS_RETURN_IF_ERROR(
      CheckFinite(state.tool.p_base_tool, [&] { return what() + ".tool.p_base_tool"; }));
  const double norm = state.tool.q_base_tool.norm();
  if (!(std::abs(norm - 1) <= kUnitQuaternionTolerance)) {
    return absl::InvalidArgumentError(absl::StrCat(what(), ".tool.q_base_tool has length ", norm,
                                                   "; send a unit quaternion (w, x, y, z)"));
  }
  return absl::OkStatus();
}

template <class What>
absl::Status CheckCommand(const Eigen::VectorXf& command, int action_dim, const What& what) {
  if (command.size() != action_dim) {
    return absl::InvalidArgumentError(absl::StrCat(
        what(), " has ", command.size(), " entries; the policy's actions have ", action_dim));
  }
  return CheckFinite(command, what);
}

}  // namespace

ResidualOptions ResidualOptionsOf(const MethodOptions& method, ResidualSpace space) {
  ResidualOptions options;
  options.space = space;
  options.scale = method.residual_scale;
  options.tracking_gain = method.tracking_gain;
  options.clip_command = method.clip_command;
  return options;
}

Eigen::VectorXd ReferenceCommand(const Eigen::VectorXf& action, const ResidualOptions& options) {
  RS_CHECK(action.size() >= 2);
  Eigen::VectorXd command = action.head(action.size() - 1).cast<double>();
  if (options.clip_command && options.space == ResidualSpace::kEndEffector) {
    command = command.cwiseMax(-1.0).cwiseMin(1.0);
  }
  return command;
}

Eigen::VectorXd AchievedDelta(const RobotState& before, const RobotState& after,
                              const ResidualOptions& options) {
  Eigen::VectorXd delta(6);
  delta.head<3>() = (after.tool.p_base_tool - before.tool.p_base_tool) / options.translation_scale;
  delta.tail<3>() =
      RotationBetween(before.tool.q_base_tool, after.tool.q_base_tool) / options.rotation_scale;
  if (options.scale == ResidualScale::kTracking) delta /= options.tracking_gain;
  return delta;
}

Eigen::VectorXd StepResidual(const RobotState& before, const RobotState& after,
                             const Eigen::VectorXf& command, const ResidualOptions& options) {
  const Eigen::VectorXd reference = ReferenceCommand(command, options);
  const Eigen::VectorXd achieved =
      options.space == ResidualSpace::kJoint ? after.q : AchievedDelta(before, after, options);
  RS_CHECK(achieved.size() == reference.size());
  Eigen::VectorXd residual = Eigen::VectorXd::Zero(command.size());
  residual.head(reference.size()) = achieved - reference;
  return residual;
}

const RobotState& StateAfter(const ExecutedChunk& chunk, size_t step) {
  RS_CHECK(step < chunk.steps.size());
  return step + 1 < chunk.steps.size() ? chunk.steps[step + 1].before : chunk.final_state;
}

ExecutedChunk StepOf(const ExecutedChunk& chunk, size_t step) {
  ExecutedChunk one;
  one.sequence = chunk.sequence;
  one.task = chunk.task;
  one.episode = chunk.episode;
  one.chunk = chunk.chunk;
  one.prediction_id = chunk.prediction_id;
  one.first_step = chunk.first_step + static_cast<int>(step);
  one.final_state = StateAfter(chunk, step);
  one.steps = {chunk.steps[step]};
  if (chunk.IsMasked(step)) one.masked = {true};
  return one;
}

absl::Status ValidateExecutedChunk(const ExecutedChunk& chunk, int action_dim,
                                   ResidualSpace space) {
  if (chunk.steps.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("executed chunk ", chunk.sequence,
                     " has no steps; send only chunks of which something was executed"));
  }
  if (space == ResidualSpace::kEndEffector && action_dim != 7) {
    return absl::InvalidArgumentError(
        absl::StrCat("the end-effector residual needs actions of 7 entries, not ", action_dim));
  }
  if (chunk.first_step < 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("first_step is ", chunk.first_step, "; it must be >= 0"));
  }
  if (!chunk.masked.empty() && chunk.masked.size() != chunk.steps.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("executed chunk ", chunk.sequence, " has ", chunk.masked.size(),
                     " mask values for ", chunk.steps.size(), " steps; give one per step or none"));
  }
  const bool has_base = chunk.steps[0].base_command.size() > 0;
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    const ExecutedStep& step = chunk.steps[i];
    const auto named = [&chunk, i](const char* part) {
      return [&chunk, i, part] {
        return absl::StrCat("executed chunk ", chunk.sequence, ", step ", i, ": ", part);
      };
    };
    if (i == 0) RS_RETURN_IF_ERROR(CheckState(step.before, named("before")));
    RS_RETURN_IF_ERROR(CheckCommand(step.policy_command, action_dim, named("policy_command")));
    RS_RETURN_IF_ERROR(CheckCommand(step.sent_command, action_dim, named("sent_command")));
    if (has_base || step.base_command.size() > 0) {
      RS_RETURN_IF_ERROR(CheckCommand(step.base_command, action_dim, named("base_command")));
    }
    const RobotState& after = StateAfter(chunk, i);
    RS_RETURN_IF_ERROR(CheckState(after, named("after")));
    if (space == ResidualSpace::kJoint && after.q.size() != action_dim - 1) {
      return absl::InvalidArgumentError(absl::StrCat(named("")(), after.q.size(),
                                                     " joints measured; the action has ",
                                                     action_dim - 1, " and a gripper"));
    }
  }
  return absl::OkStatus();
}

Eigen::MatrixXd ChunkResidual(const ExecutedChunk& chunk, const ResidualOptions& options) {
  RS_CHECK(!chunk.steps.empty());
  Eigen::MatrixXd residual(chunk.steps.size(), chunk.steps[0].policy_command.size());
  for (size_t i = 0; i < chunk.steps.size(); ++i) {
    if (chunk.IsMasked(i)) {
      residual.row(i).setZero();
      continue;
    }
    const ExecutedStep& step = chunk.steps[i];
    residual.row(i) = StepResidual(step.before, StateAfter(chunk, i), step.policy_command, options);
  }
  return residual;
}

}  // namespace robostress
