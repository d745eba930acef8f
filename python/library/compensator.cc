#include <Eigen/Core>
#include <cmath>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "adapter/command_correction.h"
#include "adapter/compensated_policy.h"
#include "adapter/measured_chunk.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/session_spec.h"
#include "common/status_macros.h"
#include "python/library/boundary.h"
#include "python/library/robostress.h"

// A CompensatedPolicy whose policy is the caller.
struct robostress_compensator {
  robostress_compensator(const robostress::MethodOptions& with,
                         const robostress::SessionSetting& setting,
                         const robostress::PolicySpec& policy)
      : method(with),
        policy(policy),
        residual(robostress::ResidualOf(setting, with)),
        correction(with, residual, robostress::NominalArmOf(setting, with)),
        running(correction) {}

  robostress::MethodOptions method;
  robostress::PolicySpec policy;
  robostress::ResidualOptions residual;
  robostress::CommandCorrection correction;
  robostress::CommandCorrection running;  // the same, with the steps of the chunk under way
  robostress::PredictedChunk chunk;       // under way
  Eigen::Index row = 0;                   // of it, next
  Eigen::VectorXf issued;                 // the command before that; empty: an episode begins
};

namespace robostress {
namespace {

using Actions =
    Eigen::Map<const Eigen::Matrix<float, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>>;

absl::Status CheckScale(const char* name, const char* unit, double value) {
  if (value > 0 && std::isfinite(value)) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("control.", name, " is ", value, " ", unit, ", must be above 0"));
}

absl::Status ReadControl(const robostress_control& from, SessionSetting& setting,
                         PolicySpec& policy) {
  RS_RETURN_IF_ERROR(ReadWord("control.space", from.space,
                              {Word<ControlSpace>{"end_effector", ControlSpace::kEndEffector},
                               {"joint", ControlSpace::kJoint}},
                              setting.control_space));
  RS_RETURN_IF_ERROR(ReadWord("control.goal_reference", from.goal_reference,
                              {Word<GoalReference>{"achieved", GoalReference::kAchieved},
                               {"desired", GoalReference::kDesired}},
                              setting.goal_reference));
  RS_RETURN_IF_ERROR(CheckScale("control_period", "s", from.control_period));
  RS_RETURN_IF_ERROR(CheckScale("translation_scale", "m", from.translation_scale));
  RS_RETURN_IF_ERROR(CheckScale("rotation_scale", "rad", from.rotation_scale));
  const bool joint = setting.control_space == ControlSpace::kJoint;
  if (joint ? from.action_dim < 2 || from.action_dim > WireLimits::kDof : from.action_dim != 7) {
    return absl::InvalidArgumentError(
        absl::StrCat("control.action_dim is ", from.action_dim, ", must be ",
                     joint ? absl::StrCat("2 to ", WireLimits::kDof, " in joint space")
                           : "7 of an end effector"));
  }
  setting.control_period_s = from.control_period;
  setting.translation_scale = from.translation_scale;
  setting.rotation_scale = from.rotation_scale;
  setting.robot = setting.policy = "yours";
  policy.name = setting.policy;
  policy.action_dim = from.action_dim;
  policy.horizon = WireLimits::kHorizon;
  if (from.action_low == nullptr && from.action_high == nullptr) return absl::OkStatus();
  RS_RETURN_IF_ERROR(CheckHandle("control.action_low", from.action_low));
  RS_RETURN_IF_ERROR(CheckHandle("control.action_high", from.action_high));
  for (int i = 0; i < from.action_dim; ++i) {
    if (from.action_low[i] <= from.action_high[i]) continue;
    return absl::InvalidArgumentError(absl::StrCat("control.action_low[", i, "] is ",
                                                   from.action_low[i], ", must be at most ",
                                                   from.action_high[i], ", action_high[", i, "]"));
  }
  policy.action_low.assign(from.action_low, from.action_low + from.action_dim);
  policy.action_high.assign(from.action_high, from.action_high + from.action_dim);
  return absl::OkStatus();
}

absl::StatusOr<MethodOptions> MethodOf(const char* name, const char* const* overrides, size_t count,
                                       const SessionSetting& setting) {
  RS_RETURN_IF_ERROR(CheckHandle("method", name));
  if (count > 0) RS_RETURN_IF_ERROR(CheckHandle("overrides", overrides));
  std::vector<std::string> given;
  for (size_t i = 0; i < count; ++i) {
    RS_RETURN_IF_ERROR(CheckHandle("an override", overrides[i]));
    given.emplace_back(overrides[i]);
  }
  RS_ASSIGN_OR_RETURN(MethodOptions method, MakeMethod(name, given));
  RS_RETURN_IF_ERROR(CheckWithoutWeights(setting, method));
  if (method.execute_steps != 0) {
    return absl::InvalidArgumentError(
        "execute_steps would change nothing here: execute as many rows of a corrected chunk as you "
        "like");
  }
  if (method.panda_dynamics) {
    return absl::InvalidArgumentError(
        "panda_dynamics needs an end effector's joint positions, which are not given here; set it "
        "to false");
  }
  const MethodOptions plain;
  if (method.observer || method.observation != plain.observation ||
      method.noise_stream != plain.noise_stream) {
    return absl::InvalidArgumentError(absl::StrCat(
        "method '", name,
        "' changes what a policy is shown or is the robot client's own, and would change nothing "
        "here; take base, gain, smooth, direct, ours_integral, ours_following, ours_following_step "
        "or "
        "ours_following_smooth"));
  }
  return method;
}

absl::StatusOr<ExecutedChunk> ReadExecuted(const robostress_compensator& compensator,
                                           const robostress_executed* given) {
  robostress_executed from = {};
  RS_RETURN_IF_ERROR(ReadStructure("executed", given, from));
  if (from.steps < 1 || from.steps > WireLimits::kHorizon) {
    return absl::InvalidArgumentError(
        absl::StrCat("executed.steps is ", from.steps, ", must be 1 to ", WireLimits::kHorizon));
  }
  const bool joint = compensator.residual.space == ResidualSpace::kJoint;
  const Eigen::Index width = compensator.policy.action_dim;
  RS_RETURN_IF_ERROR(CheckHandle("executed.policy_command", from.policy_command));
  RS_RETURN_IF_ERROR(CheckHandle("executed.sent_command", from.sent_command));
  if (joint) RS_RETURN_IF_ERROR(CheckHandle("executed.q", from.q));
  if (!joint) RS_RETURN_IF_ERROR(CheckHandle("executed.position", from.position));
  if (!joint) RS_RETURN_IF_ERROR(CheckHandle("executed.orientation", from.orientation));
  const auto state = [&](size_t i) {
    RobotState at;
    if (joint) at.q = Eigen::Map<const Eigen::VectorXd>(from.q + i * (width - 1), width - 1);
    if (from.position != nullptr) at.tool.p_base_tool = Eigen::Vector3d(from.position + 3 * i);
    if (const double* wxyz = from.orientation; wxyz != nullptr)
      at.tool.q_base_tool = {wxyz[4 * i], wxyz[4 * i + 1], wxyz[4 * i + 2], wxyz[4 * i + 3]};
    return at;
  };
  ExecutedChunk chunk;
  for (size_t i = 0; i < from.steps; ++i) {
    ExecutedStep step;
    step.before = state(i);
    step.policy_command = Eigen::Map<const Eigen::VectorXf>(from.policy_command + i * width, width);
    step.sent_command = Eigen::Map<const Eigen::VectorXf>(from.sent_command + i * width, width);
    chunk.steps.push_back(std::move(step));
    if (from.masked != nullptr) chunk.masked.push_back(from.masked[i] != 0);
  }
  chunk.final_state = state(from.steps);
  return chunk;
}

absl::StatusOr<MeasuredChunk> Measured(const robostress_compensator& compensator,
                                       const ExecutedChunk& chunk) {
  return MeasuredChunk::Create(chunk, compensator.policy, compensator.residual);
}

void CopyRows(const Eigen::MatrixXf& from, float* to) {
  for (Eigen::Index i = 0; i < from.rows(); ++i)
    for (Eigen::Index j = 0; j < from.cols(); ++j) *to++ = from(i, j);
}

}  // namespace
}  // namespace robostress

using robostress::AtBoundary;
using robostress::CheckHandle;

extern "C" {

void robostress_control_default(robostress_control* control) {
  robostress_control defaults = {sizeof(defaults), "end_effector", 7,      0.05, 0.05, 0.5,
                                 "achieved",       nullptr,        nullptr};
  if (control != nullptr) robostress::CopyStructure(defaults, *control);
}

robostress_code robostress_compensator_new(const char* method, const char* const* overrides,
                                           size_t override_count, const robostress_control* control,
                                           robostress_compensator** created, char* error,
                                           size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("created", created));
    robostress_control given;
    given.size = sizeof(given);
    robostress_control_default(&given);
    if (control != nullptr)
      RS_RETURN_IF_ERROR(robostress::ReadStructure("control", control, given));
    robostress::SessionSetting setting;
    robostress::PolicySpec policy;
    RS_RETURN_IF_ERROR(robostress::ReadControl(given, setting, policy));
    RS_ASSIGN_OR_RETURN(const robostress::MethodOptions options,
                        robostress::MethodOf(method, overrides, override_count, setting));
    *created = new robostress_compensator(options, setting, policy);
    return absl::OkStatus();
  });
}

void robostress_compensator_free(robostress_compensator* compensator) { delete compensator; }

robostress_code robostress_compensator_copy(const robostress_compensator* from,
                                            robostress_compensator** created, char* error,
                                            size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("from", from));
    RS_RETURN_IF_ERROR(CheckHandle("created", created));
    *created = new robostress_compensator(*from);
    return absl::OkStatus();
  });
}

robostress_code robostress_compensator_restore(robostress_compensator* to,
                                               const robostress_compensator* from, char* error,
                                               size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("to", to));
    RS_RETURN_IF_ERROR(CheckHandle("from", from));
    robostress_compensator copy(*from);  // whatever fails, fails here
    *to = std::move(copy);
    return absl::OkStatus();
  });
}

int robostress_compensator_action_dim(const robostress_compensator* compensator) {
  return compensator == nullptr ? 0 : compensator->policy.action_dim;
}

int robostress_compensator_every_step(const robostress_compensator* compensator) {
  return compensator != nullptr && compensator->method.every_step ? 1 : 0;
}

void robostress_compensator_start_episode(robostress_compensator* compensator) {
  if (compensator == nullptr) return;
  (void)AtBoundary(nullptr, 0, [&] {
    compensator->correction.StartEpisode();
    compensator->running = compensator->correction;
    compensator->chunk = {};
    compensator->issued.resize(0);
    compensator->row = 0;
    return absl::OkStatus();
  });
}

robostress_code robostress_compensator_correct(robostress_compensator* compensator,
                                               const float* actions, size_t rows, float* corrected,
                                               char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("compensator", compensator));
    RS_RETURN_IF_ERROR(CheckHandle("actions", actions));
    RS_RETURN_IF_ERROR(CheckHandle("corrected", corrected));
    if (rows < 1 || rows > robostress::WireLimits::kHorizon) {
      return absl::InvalidArgumentError(
          absl::StrCat("rows is ", rows, ", must be 1 to ", robostress::WireLimits::kHorizon));
    }
    const int width = compensator->policy.action_dim;
    robostress::PredictedChunk chunk;
    chunk.policy_actions = robostress::Actions(actions, static_cast<Eigen::Index>(rows), width);
    for (Eigen::Index i = 0; i < chunk.policy_actions.rows(); ++i) {
      for (Eigen::Index j = 0; j < width; ++j) {
        if (std::isfinite(chunk.policy_actions(i, j))) continue;
        return absl::InvalidArgumentError(absl::StrCat(
            "actions[", i, "][", j, "] is ", chunk.policy_actions(i, j), ", must be finite"));
      }
    }
    robostress::CorrectCommands(compensator->method, compensator->policy,
                                compensator->correction.Value(), chunk);
    compensator->chunk = std::move(chunk);
    compensator->running = compensator->correction;
    compensator->row = 0;
    robostress::CopyRows(compensator->chunk.actions, corrected);
    return absl::OkStatus();
  });
}

robostress_code robostress_compensator_next(robostress_compensator* compensator,
                                            const robostress_executed* newest, float* command,
                                            char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("compensator", compensator));
    RS_RETURN_IF_ERROR(CheckHandle("command", command));
    const robostress::PredictedChunk& chunk = compensator->chunk;
    if (compensator->row >= chunk.actions.rows()) {
      return absl::FailedPreconditionError(absl::StrCat(
          "all ", chunk.actions.rows(),
          " rows of the chunk are used up: call robostress_compensator_correct with the next one"));
    }
    robostress::PredictedChunk next;
    next.policy_actions = chunk.policy_actions.row(compensator->row);
    next.actions = chunk.actions.row(compensator->row);
    if (newest != nullptr) {
      RS_ASSIGN_OR_RETURN(const robostress::ExecutedChunk executed,
                          robostress::ReadExecuted(*compensator, newest));
      RS_ASSIGN_OR_RETURN(const robostress::MeasuredChunk measured,
                          robostress::Measured(*compensator, executed));
      if (compensator->method.every_step) {
        compensator->running.Observe(measured.usable());
        robostress::CorrectCommands(compensator->method, compensator->policy,
                                    compensator->running.Value(), next);
      }
    }
    ++compensator->row;
    Eigen::VectorXf issued = next.actions.row(0).transpose();
    robostress::SmoothCommand(compensator->method.smoothing, compensator->issued, issued);
    robostress::CopyRows(issued.transpose(), command);
    compensator->issued = std::move(issued);
    return absl::OkStatus();
  });
}

robostress_code robostress_compensator_executed(robostress_compensator* compensator,
                                                const robostress_executed* executed, char* error,
                                                size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("compensator", compensator));
    RS_ASSIGN_OR_RETURN(const robostress::ExecutedChunk chunk,
                        robostress::ReadExecuted(*compensator, executed));
    RS_ASSIGN_OR_RETURN(const robostress::MeasuredChunk measured,
                        robostress::Measured(*compensator, chunk));
    compensator->correction.Observe(measured.usable());
    return absl::OkStatus();
  });
}

void robostress_compensator_correction(const robostress_compensator* compensator,
                                       double* correction) {
  if (compensator == nullptr || correction == nullptr) return;
  (void)AtBoundary(nullptr, 0, [&] {
    const Eigen::VectorXd value = compensator->correction.Value();
    for (int i = 0; i + 1 < compensator->policy.action_dim; ++i)
      correction[i] = i < value.size() ? value[i] : 0;
    return absl::OkStatus();
  });
}

robostress_code robostress_compensator_residual(const robostress_compensator* compensator,
                                                const robostress_executed* executed,
                                                double* residual, char* error, size_t error_size) {
  return AtBoundary(error, error_size, [&]() -> absl::Status {
    RS_RETURN_IF_ERROR(CheckHandle("compensator", compensator));
    RS_RETURN_IF_ERROR(CheckHandle("residual", residual));
    RS_ASSIGN_OR_RETURN(const robostress::ExecutedChunk chunk,
                        robostress::ReadExecuted(*compensator, executed));
    RS_ASSIGN_OR_RETURN(const robostress::MeasuredChunk measured,
                        robostress::Measured(*compensator, chunk));
    const Eigen::MatrixXd& rows = measured.residual();
    for (Eigen::Index i = 0; i < rows.rows(); ++i)
      for (Eigen::Index j = 0; j < rows.cols(); ++j) *residual++ = rows(i, j);
    return absl::OkStatus();
  });
}

}  // extern "C"
