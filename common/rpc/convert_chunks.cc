#include "common/rpc/convert_chunks.h"

#include <cmath>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/check.h"
#include "common/rollout/field_checks.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

absl::StatusOr<Eigen::VectorXd> JointVector(const char* field,
                                            const google::protobuf::RepeatedField<double>& values) {
  RS_RETURN_IF_ERROR(
      CheckRange(absl::StrCat(field, " size").c_str(), values.size(), 0, WireLimits::kDof));
  Eigen::VectorXd out(values.size());
  for (int i = 0; i < values.size(); ++i) {
    RS_RETURN_IF_ERROR(CheckFinite(absl::StrCat(field, "[", i, "]"), values[i]));
    out[i] = values[i];
  }
  return out;
}

Eigen::MatrixXf CommandRows(const ExecutedChunk& chunk, Eigen::VectorXf ExecutedStep::*command) {
  const int n = static_cast<int>(chunk.steps.size());
  RS_CHECK(n >= 1);
  const Eigen::Index cols = (chunk.steps[0].*command).size();
  if (cols == 0) return {};
  Eigen::MatrixXf rows(n, cols);
  for (int i = 0; i < n; ++i) {
    RS_CHECK((chunk.steps[i].*command).size() == cols);
    rows.row(i) = (chunk.steps[i].*command).transpose();
  }
  return rows;
}

}  // namespace

robostress::v1::FloatMatrix ToProto(const Eigen::MatrixXf& matrix) {
  v1::FloatMatrix message;
  message.set_rows(static_cast<uint32_t>(matrix.rows()));
  message.set_cols(static_cast<uint32_t>(matrix.cols()));
  message.mutable_data()->Reserve(static_cast<int>(matrix.size()));
  for (Eigen::Index r = 0; r < matrix.rows(); ++r) {
    for (Eigen::Index c = 0; c < matrix.cols(); ++c) message.add_data(matrix(r, c));
  }
  return message;
}

absl::StatusOr<Eigen::MatrixXf> FromProto(const char* field,
                                          const robostress::v1::FloatMatrix& message) {
  RS_RETURN_IF_ERROR(
      CheckRange(absl::StrCat(field, ".rows").c_str(), message.rows(), 1, WireLimits::kHorizon));
  RS_RETURN_IF_ERROR(
      CheckRange(absl::StrCat(field, ".cols").c_str(), message.cols(), 1, WireLimits::kActionDim));
  const int rows = static_cast<int>(message.rows()), cols = static_cast<int>(message.cols());
  if (message.data_size() != rows * cols) {
    return Invalid(field, " has ", message.data_size(), " values, ", rows, " x ", cols, " needs ",
                   rows * cols);
  }
  Eigen::MatrixXf matrix(rows, cols);
  for (int r = 0; r < rows; ++r) {
    for (int c = 0; c < cols; ++c) {
      const float value = message.data(r * cols + c);
      RS_RETURN_IF_ERROR(CheckFinite(absl::StrCat(field, "[", r, ",", c, "]"), value));
      matrix(r, c) = value;
    }
  }
  return matrix;
}

robostress::v1::PredictResponse ToProto(const PredictedChunk& prediction, int chunk) {
  v1::PredictResponse message;
  message.set_prediction_id(prediction.prediction_id);
  message.set_chunk(static_cast<uint32_t>(chunk));
  *message.mutable_actions() = ToProto(prediction.actions);
  const bool same = prediction.policy_actions.rows() == prediction.actions.rows() &&
                    prediction.policy_actions.cols() == prediction.actions.cols() &&
                    (prediction.policy_actions.array() == prediction.actions.array()).all();
  if (!same && prediction.policy_actions.size() > 0)
    *message.mutable_policy_actions() = ToProto(prediction.policy_actions);
  if (prediction.base_actions.size() > 0)
    *message.mutable_base_actions() = ToProto(prediction.base_actions);
  message.set_adapter_version(prediction.adapter_version);
  message.set_queue_ms(static_cast<float>(prediction.queue_ms));
  message.set_compute_ms(static_cast<float>(prediction.compute_ms));
  message.set_batch_size(static_cast<uint32_t>(prediction.batch_size));
  return message;
}

absl::StatusOr<PredictedChunk> FromProto(const robostress::v1::PredictResponse& message) {
  PredictedChunk prediction;
  prediction.prediction_id = message.prediction_id();
  prediction.adapter_version = message.adapter_version();
  prediction.queue_ms = message.queue_ms();
  prediction.compute_ms = message.compute_ms();
  RS_RETURN_IF_ERROR(CheckRange("batch_size", message.batch_size(), 0, WireLimits::kIndex));
  prediction.batch_size = static_cast<int>(message.batch_size());
  RS_ASSIGN_OR_RETURN(prediction.actions, FromProto("actions", message.actions()));
  const int rows = static_cast<int>(prediction.actions.rows()),
            cols = static_cast<int>(prediction.actions.cols());
  prediction.policy_actions = prediction.actions;
  if (message.has_policy_actions()) {
    RS_ASSIGN_OR_RETURN(prediction.policy_actions,
                        FromProto("policy_actions", message.policy_actions()));
    RS_RETURN_IF_ERROR(CheckMatrixSize("policy_actions", prediction.policy_actions, rows, cols));
  }
  if (message.has_base_actions()) {
    RS_ASSIGN_OR_RETURN(prediction.base_actions, FromProto("base_actions", message.base_actions()));
    RS_RETURN_IF_ERROR(CheckMatrixSize("base_actions", prediction.base_actions, rows, cols));
  }
  return prediction;
}

robostress::v1::RunningRows ToProto(const RunningRows& running) {
  v1::RunningRows message;
  *message.mutable_actions() = ToProto(running.actions);
  message.set_held(static_cast<uint32_t>(running.held));
  return message;
}

absl::StatusOr<RunningRows> FromProto(const robostress::v1::RunningRows& message) {
  RunningRows running;
  RS_ASSIGN_OR_RETURN(running.actions, FromProto("running.actions", message.actions()));
  RS_RETURN_IF_ERROR(
      CheckRange("running.held", message.held(), 0, static_cast<uint64_t>(running.actions.rows())));
  running.held = static_cast<int>(message.held());
  return running;
}

robostress::v1::RobotState ToProto(const RobotState& state) {
  v1::RobotState message;
  message.set_stamp_s(state.stamp_s);
  message.mutable_q()->Add(state.q.data(), state.q.data() + state.q.size());
  message.mutable_dq()->Add(state.dq.data(), state.dq.data() + state.dq.size());
  for (int i = 0; i < 3; ++i) message.add_p_base_tool(state.tool.p_base_tool[i]);
  const Eigen::Quaterniond& q = state.tool.q_base_tool;
  for (const double value : {q.w(), q.x(), q.y(), q.z()}) message.add_q_base_tool(value);
  message.set_gripper(state.gripper);
  return message;
}

absl::StatusOr<RobotState> FromProto(const robostress::v1::RobotState& message) {
  RobotState state;
  RS_RETURN_IF_ERROR(CheckFinite("state.stamp_s", message.stamp_s()));
  RS_RETURN_IF_ERROR(CheckFinite("state.gripper", message.gripper()));
  state.stamp_s = message.stamp_s();
  state.gripper = message.gripper();
  RS_ASSIGN_OR_RETURN(state.q, JointVector("state.q", message.q()));
  RS_ASSIGN_OR_RETURN(state.dq, JointVector("state.dq", message.dq()));
  if (state.q.size() != state.dq.size()) {
    return Invalid("state.q has ", state.q.size(), " joints, state.dq ", state.dq.size());
  }
  RS_ASSIGN_OR_RETURN(const Eigen::VectorXd p,
                      JointVector("state.p_base_tool", message.p_base_tool()));
  RS_ASSIGN_OR_RETURN(const Eigen::VectorXd q,
                      JointVector("state.q_base_tool", message.q_base_tool()));
  if (p.size() != 3) return Invalid("state.p_base_tool has ", p.size(), " values, must have 3");
  if (q.size() != 4)
    return Invalid("state.q_base_tool has ", q.size(), " values, must have 4 (w, x, y, z)");
  if (std::abs(q.norm() - 1) > WireLimits::kQuaternionNormError) {
    return Invalid("state.q_base_tool has norm ", q.norm(), ", must be 1 within ",
                   WireLimits::kQuaternionNormError);
  }
  state.tool.p_base_tool = p;
  state.tool.q_base_tool = Eigen::Quaterniond(q[0], q[1], q[2], q[3]);
  return state;
}

robostress::v1::ExecutedChunk ToProto(const ExecutedChunk& chunk) {
  v1::ExecutedChunk message;
  message.set_sequence(chunk.sequence);
  message.set_task(static_cast<uint32_t>(chunk.task));
  message.set_episode(static_cast<uint32_t>(chunk.episode));
  message.set_chunk(static_cast<uint32_t>(chunk.chunk));
  message.set_prediction_id(chunk.prediction_id);
  message.set_first_step(static_cast<uint32_t>(chunk.first_step));
  for (const ExecutedStep& step : chunk.steps) *message.add_states() = ToProto(step.before);
  *message.add_states() = ToProto(chunk.final_state);
  *message.mutable_policy_commands() = ToProto(CommandRows(chunk, &ExecutedStep::policy_command));
  *message.mutable_sent_commands() = ToProto(CommandRows(chunk, &ExecutedStep::sent_command));
  const Eigen::MatrixXf base = CommandRows(chunk, &ExecutedStep::base_command);
  if (base.size() > 0) *message.mutable_base_commands() = ToProto(base);
  message.set_last_of_episode(chunk.last_of_episode);
  for (const bool masked : chunk.masked) message.add_masked(masked);
  return message;
}

absl::StatusOr<ExecutedChunk> FromProto(const robostress::v1::ExecutedChunk& message) {
  if (message.sequence() == 0)
    return Invalid("chunk.sequence is 0, the first chunk has sequence 1");
  RS_RETURN_IF_ERROR(CheckRange("chunk.task", message.task(), 0, WireLimits::kIndex));
  RS_RETURN_IF_ERROR(CheckRange("chunk.episode", message.episode(), 0, WireLimits::kIndex));
  RS_RETURN_IF_ERROR(CheckRange("chunk.chunk", message.chunk(), 0, WireLimits::kIndex));
  RS_RETURN_IF_ERROR(
      CheckRange("chunk.first_step", message.first_step(), 0, WireLimits::kHorizon - 1));
  RS_RETURN_IF_ERROR(
      CheckRange("chunk.states size", message.states_size(), 2, WireLimits::kHorizon + 1));
  const int n = message.states_size() - 1;
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXf policy,
                      FromProto("chunk.policy_commands", message.policy_commands()));
  const int action_dim = static_cast<int>(policy.cols());
  RS_RETURN_IF_ERROR(CheckMatrixSize("chunk.policy_commands", policy, n, action_dim));
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXf sent,
                      FromProto("chunk.sent_commands", message.sent_commands()));
  RS_RETURN_IF_ERROR(CheckMatrixSize("chunk.sent_commands", sent, n, action_dim));
  Eigen::MatrixXf base;
  if (message.has_base_commands()) {
    RS_ASSIGN_OR_RETURN(base, FromProto("chunk.base_commands", message.base_commands()));
    RS_RETURN_IF_ERROR(CheckMatrixSize("chunk.base_commands", base, n, action_dim));
  }

  ExecutedChunk chunk;
  chunk.sequence = message.sequence();
  chunk.task = static_cast<int>(message.task());
  chunk.episode = static_cast<int>(message.episode());
  chunk.chunk = static_cast<int>(message.chunk());
  chunk.prediction_id = message.prediction_id();
  chunk.first_step = static_cast<int>(message.first_step());
  chunk.last_of_episode = message.last_of_episode();
  if (message.masked_size() != 0 && message.masked_size() != n) {
    return Invalid("chunk.masked has ", message.masked_size(), " values for ", n,
                   " steps; give one per step or none");
  }
  chunk.masked.assign(message.masked().begin(), message.masked().end());
  chunk.steps.resize(n);
  for (int i = 0; i <= n; ++i) {
    absl::StatusOr<RobotState> state = FromProto(message.states(i));
    if (!state.ok()) return Invalid("chunk.states[", i, "]: ", state.status().message());
    const Eigen::Index dof = i == 0 ? state->q.size() : chunk.steps[0].before.q.size();
    if (state->q.size() != dof) {
      return Invalid("chunk.states[", i, "].q has ", state->q.size(), " joints, states[0] has ",
                     dof);
    }
    if (i == n) {
      chunk.final_state = *std::move(state);
      continue;
    }
    ExecutedStep& step = chunk.steps[i];
    step.before = *std::move(state);
    step.policy_command = policy.row(i).transpose();
    step.sent_command = sent.row(i).transpose();
    if (base.size() > 0) step.base_command = base.row(i).transpose();
  }
  return chunk;
}

}  // namespace robostress
