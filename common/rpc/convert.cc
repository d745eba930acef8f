#include "common/rpc/convert.h"

#include <algorithm>
#include <cmath>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/check.h"
#include "common/config.h"
#include "common/rpc/refusal.h"
#include "common/rpc/spec_checks.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr size_t kMaxRefusalMessage = 4096;
constexpr uint32_t kMaxRetryAfterMs = 24 * 3600 * 1000;

template <class... Parts>
absl::Status Invalid(const Parts&... parts) {
  return absl::InvalidArgumentError(absl::StrCat(parts...));
}

absl::Status CheckRange(const char* field, uint64_t value, uint64_t low, uint64_t high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return Invalid(field, " is ", value, ", must be ", low, " to ", high);
}

absl::Status CheckFinite(const std::string& field, double value) {
  if (std::isfinite(value)) return absl::OkStatus();
  return Invalid(field, " is ", value, ", must be finite");
}

// A name that can stand in a path or a key: printable ASCII without spaces, quotes and backslashes.
absl::Status CheckName(const char* field, const std::string& name, bool may_be_empty = false) {
  if (name.empty() && !may_be_empty) return Invalid(field, " is empty");
  if (name.size() > WireLimits::kName) {
    return Invalid(field, " has ", name.size(), " bytes, at most ", WireLimits::kName,
                   " are allowed");
  }
  for (const char c : name) {
    if (c > ' ' && c < 127 && c != '"' && c != '\'' && c != '\\') continue;
    return Invalid(field, " contains byte ", static_cast<int>(static_cast<unsigned char>(c)),
                   "; names are printable ASCII without spaces and quotes");
  }
  return absl::OkStatus();
}

absl::Status CheckText(const char* field, const std::string& text, size_t limit) {
  if (text.size() <= limit) return absl::OkStatus();
  return Invalid(field, " has ", text.size(), " bytes, at most ", limit, " are allowed");
}

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

v1::ControlSpace ToProto(ControlSpace space) {
  switch (space) {
    case ControlSpace::kEndEffector:
      return v1::CONTROL_SPACE_END_EFFECTOR;
    case ControlSpace::kJoint:
      return v1::CONTROL_SPACE_JOINT;
    default:
      return v1::CONTROL_SPACE_UNSPECIFIED;
  }
}

absl::StatusOr<ControlSpace> FromProto(const char* field, v1::ControlSpace space) {
  switch (space) {
    case v1::CONTROL_SPACE_UNSPECIFIED:
      return ControlSpace::kUnspecified;
    case v1::CONTROL_SPACE_END_EFFECTOR:
      return ControlSpace::kEndEffector;
    case v1::CONTROL_SPACE_JOINT:
      return ControlSpace::kJoint;
    default:
      return Invalid(field, " is ", static_cast<int>(space),
                     ", must be END_EFFECTOR (1), JOINT (2), or absent");
  }
}

}  // namespace

robostress::v1::SessionSpec ToProto(const SessionSpec& spec) {
  v1::SessionSpec message;
  message.set_robot(spec.robot);
  message.set_suite(spec.suite);
  message.set_scenario(spec.scenario);
  message.set_severity(static_cast<uint32_t>(spec.severity));
  message.set_policy(spec.policy);
  message.set_seed(spec.seed);
  message.set_mode(spec.mode == ExecutionMode::kLockstep ? v1::EXECUTION_MODE_LOCKSTEP
                                                         : v1::EXECUTION_MODE_ASYNC);
  message.set_goal_reference(spec.goal_reference == GoalReference::kAchieved
                                 ? v1::GOAL_REFERENCE_ACHIEVED
                                 : v1::GOAL_REFERENCE_DESIRED);
  message.set_control_space(ToProto(spec.control_space));
  message.set_method_yaml(DumpConfig(spec.method));
  message.set_control_period_s(spec.control_period_s);
  message.set_translation_scale(spec.translation_scale);
  message.set_rotation_scale(spec.rotation_scale);
  return message;
}

namespace {

// All of a spec but its method.
absl::StatusOr<SessionSpec> WithoutMethod(const robostress::v1::SessionSpec& message) {
  RS_RETURN_IF_ERROR(CheckName("spec.robot", message.robot()));
  RS_RETURN_IF_ERROR(CheckName("spec.suite", message.suite()));
  RS_RETURN_IF_ERROR(CheckName("spec.scenario", message.scenario()));
  RS_RETURN_IF_ERROR(CheckName("spec.policy", message.policy()));
  RS_RETURN_IF_ERROR(CheckRange("spec.severity", message.severity(), 1, 5));
  RS_RETURN_IF_ERROR(CheckText("spec.method_yaml", message.method_yaml(), WireLimits::kMethodYaml));
  const std::pair<const char*, double> scales[] = {
      {"spec.control_period_s", message.control_period_s()},
      {"spec.translation_scale", message.translation_scale()},
      {"spec.rotation_scale", message.rotation_scale()}};
  for (const auto& [field, value] : scales) {
    if (!(value > 0 && value <= 100))
      return Invalid(field, " is ", value, ", must be above 0 and at most 100");
  }
  SessionSpec spec;
  if (message.mode() == v1::EXECUTION_MODE_LOCKSTEP) {
    spec.mode = ExecutionMode::kLockstep;
  } else if (message.mode() == v1::EXECUTION_MODE_ASYNC) {
    spec.mode = ExecutionMode::kAsync;
  } else {
    return Invalid("spec.mode is ", static_cast<int>(message.mode()),
                   ", must be LOCKSTEP (1) or ASYNC (2)");
  }
  if (message.goal_reference() == v1::GOAL_REFERENCE_ACHIEVED) {
    spec.goal_reference = GoalReference::kAchieved;
  } else if (message.goal_reference() == v1::GOAL_REFERENCE_DESIRED) {
    spec.goal_reference = GoalReference::kDesired;
  } else {
    return Invalid("spec.goal_reference is ", static_cast<int>(message.goal_reference()),
                   ", must be ACHIEVED (1) or DESIRED (2)");
  }
  RS_ASSIGN_OR_RETURN(spec.control_space, FromProto("spec.control_space", message.control_space()));
  spec.robot = message.robot();
  spec.suite = message.suite();
  spec.scenario = message.scenario();
  spec.severity = static_cast<int>(message.severity());
  spec.policy = message.policy();
  spec.seed = message.seed();
  spec.control_period_s = message.control_period_s();
  spec.translation_scale = message.translation_scale();
  spec.rotation_scale = message.rotation_scale();
  return spec;
}

}  // namespace

absl::StatusOr<SessionSpec> FromProto(const robostress::v1::SessionSpec& message) {
  RS_ASSIGN_OR_RETURN(SessionSpec spec, WithoutMethod(message));
  RS_ASSIGN_OR_RETURN(spec.method, ParseMethod("spec.method_yaml", message.method_yaml()));
  return spec;
}

absl::StatusOr<SessionSpec> FromStored(const robostress::v1::SessionSpec& message) {
  RS_ASSIGN_OR_RETURN(SessionSpec spec, WithoutMethod(message));
  RS_ASSIGN_OR_RETURN(spec.method,
                      ParseConfig<MethodOptions>("spec.method_yaml", message.method_yaml()));
  return spec;
}

robostress::v1::PolicySpec ToProto(const PolicySpec& spec) {
  v1::PolicySpec message;
  message.set_name(spec.name);
  message.set_model_hash(spec.model_hash);
  for (const std::string& camera : spec.cameras) message.add_cameras(camera);
  message.set_image_width(static_cast<uint32_t>(spec.image_width));
  message.set_image_height(static_cast<uint32_t>(spec.image_height));
  message.set_state_dim(static_cast<uint32_t>(spec.state_dim));
  message.set_action_dim(static_cast<uint32_t>(spec.action_dim));
  message.set_horizon(static_cast<uint32_t>(spec.horizon));
  message.set_execute_steps(static_cast<uint32_t>(spec.execute_steps));
  message.set_adaptable(spec.adaptable);
  message.set_resizes_images(spec.resizes_images);
  message.set_max_view_side(static_cast<uint32_t>(spec.max_view_side));
  message.set_control_space(ToProto(spec.control_space));
  message.mutable_action_low()->Add(spec.action_low.begin(), spec.action_low.end());
  message.mutable_action_high()->Add(spec.action_high.begin(), spec.action_high.end());
  return message;
}

absl::StatusOr<PolicySpec> FromProto(const robostress::v1::PolicySpec& message) {
  RS_RETURN_IF_ERROR(CheckName("policy.name", message.name()));
  RS_RETURN_IF_ERROR(CheckName("policy.model_hash", message.model_hash(), /*may_be_empty=*/true));
  RS_RETURN_IF_ERROR(
      CheckRange("policy.cameras size", message.cameras_size(), 0, WireLimits::kViews));
  for (const std::string& camera : message.cameras())
    RS_RETURN_IF_ERROR(CheckName("policy.cameras", camera));
  if (message.cameras_size() > 0) {
    RS_RETURN_IF_ERROR(
        CheckRange("policy.image_width", message.image_width(), 1, WireLimits::kImageSide));
    RS_RETURN_IF_ERROR(
        CheckRange("policy.image_height", message.image_height(), 1, WireLimits::kImageSide));
  }
  RS_RETURN_IF_ERROR(CheckRange("policy.state_dim", message.state_dim(), 0, WireLimits::kStateDim));
  RS_RETURN_IF_ERROR(
      CheckRange("policy.action_dim", message.action_dim(), 1, WireLimits::kActionDim));
  RS_RETURN_IF_ERROR(CheckRange("policy.horizon", message.horizon(), 1, WireLimits::kHorizon));
  RS_RETURN_IF_ERROR(
      CheckRange("policy.execute_steps", message.execute_steps(), 1, message.horizon()));
  PolicySpec spec;
  spec.name = message.name();
  spec.model_hash = message.model_hash();
  spec.cameras.assign(message.cameras().begin(), message.cameras().end());
  spec.image_width = static_cast<int>(message.image_width());
  spec.image_height = static_cast<int>(message.image_height());
  spec.state_dim = static_cast<int>(message.state_dim());
  spec.action_dim = static_cast<int>(message.action_dim());
  spec.horizon = static_cast<int>(message.horizon());
  spec.execute_steps = static_cast<int>(message.execute_steps());
  spec.adaptable = message.adaptable();
  spec.resizes_images = message.resizes_images();
  RS_RETURN_IF_ERROR(
      CheckRange("policy.max_view_side", message.max_view_side(), 0, WireLimits::kImageSide));
  if (message.max_view_side() != 0) spec.max_view_side = static_cast<int>(message.max_view_side());
  RS_ASSIGN_OR_RETURN(spec.control_space,
                      FromProto("policy.control_space", message.control_space()));
  spec.action_low.assign(message.action_low().begin(), message.action_low().end());
  spec.action_high.assign(message.action_high().begin(), message.action_high().end());
  RS_RETURN_IF_ERROR(CheckActionRange(spec));
  return spec;
}

robostress::v1::Priority ToProto(Priority priority) {
  switch (priority) {
    case Priority::kSimulation:
      return v1::PRIORITY_SIMULATION;
    case Priority::kRobot:
      return v1::PRIORITY_ROBOT;
    default:
      return v1::PRIORITY_UNSPECIFIED;
  }
}

absl::StatusOr<Priority> FromProto(robostress::v1::Priority message) {
  switch (message) {
    case v1::PRIORITY_UNSPECIFIED:
      return Priority::kUnspecified;
    case v1::PRIORITY_SIMULATION:
      return Priority::kSimulation;
    case v1::PRIORITY_ROBOT:
      return Priority::kRobot;
    default:
      return Invalid("priority is ", static_cast<int>(message),
                     ", must be UNSPECIFIED (0), SIMULATION (1) or ROBOT (2)");
  }
}

robostress::v1::GetServerInfoResponse ToProto(const ServerInfo& info) {
  v1::GetServerInfoResponse message;
  message.set_version(info.version);
  for (const PolicySpec& policy : info.policies) *message.add_policies() = ToProto(policy);
  message.set_open_sessions(static_cast<uint32_t>(info.open_sessions));
  message.set_max_sessions(static_cast<uint32_t>(info.max_sessions));
  message.set_inference_threads(static_cast<uint32_t>(info.inference_threads));
  message.set_durable(info.durable);
  message.set_instance(info.instance);
  message.set_draining(info.draining);
  return message;
}

absl::StatusOr<ServerInfo> FromProto(const robostress::v1::GetServerInfoResponse& message) {
  RS_RETURN_IF_ERROR(CheckName("version", message.version(), /*may_be_empty=*/true));
  RS_RETURN_IF_ERROR(CheckRange("open_sessions", message.open_sessions(), 0, WireLimits::kIndex));
  RS_RETURN_IF_ERROR(CheckRange("max_sessions", message.max_sessions(), 0, WireLimits::kIndex));
  RS_RETURN_IF_ERROR(
      CheckRange("inference_threads", message.inference_threads(), 0, WireLimits::kIndex));
  ServerInfo info;
  info.version = message.version();
  for (const v1::PolicySpec& policy : message.policies()) {
    RS_ASSIGN_OR_RETURN(info.policies.emplace_back(), FromProto(policy));
  }
  info.open_sessions = static_cast<int>(message.open_sessions());
  info.max_sessions = static_cast<int>(message.max_sessions());
  info.inference_threads = static_cast<int>(message.inference_threads());
  RS_RETURN_IF_ERROR(CheckName("instance", message.instance(), /*may_be_empty=*/true));
  info.durable = message.durable();
  info.instance = message.instance();
  info.draining = message.draining();
  return info;
}

robostress::v1::Observation ToProto(const Observation& observation) {
  v1::Observation message;
  message.set_instruction(observation.instruction);
  for (const CameraView& view : observation.views) {
    v1::CameraView* out = message.add_views();
    out->set_camera(view.camera);
    out->mutable_image()->set_width(static_cast<uint32_t>(view.image.width));
    out->mutable_image()->set_height(static_cast<uint32_t>(view.image.height));
    out->mutable_image()->set_data(view.image.data.data(), view.image.data.size());
  }
  message.mutable_proprioception()->Add(
      observation.proprioception.data(),
      observation.proprioception.data() + observation.proprioception.size());
  return message;
}

absl::StatusOr<Observation> FromProto(const robostress::v1::Observation& message) {
  RS_RETURN_IF_ERROR(
      CheckText("observation.instruction", message.instruction(), WireLimits::kInstruction));
  RS_RETURN_IF_ERROR(
      CheckRange("observation.views size", message.views_size(), 0, WireLimits::kViews));
  RS_RETURN_IF_ERROR(CheckRange("observation.proprioception size", message.proprioception_size(), 0,
                                WireLimits::kStateDim));
  Observation observation;
  observation.instruction = message.instruction();
  for (const v1::CameraView& view : message.views()) {
    RS_RETURN_IF_ERROR(CheckName("observation.views.camera", view.camera()));
    const v1::Image& image = view.image();
    RS_RETURN_IF_ERROR(
        CheckRange("observation.views.image.width", image.width(), 1, WireLimits::kImageSide));
    RS_RETURN_IF_ERROR(
        CheckRange("observation.views.image.height", image.height(), 1, WireLimits::kImageSide));
    const size_t expected = size_t{3} * image.width() * image.height();
    if (image.data().size() != expected) {
      return Invalid("view '", view.camera(), "' has ", image.data().size(),
                     " bytes of image data, ", image.width(), " x ", image.height(), " RGB needs ",
                     expected);
    }
    CameraView& out = observation.views.emplace_back();
    out.camera = view.camera();
    out.image.width = static_cast<int>(image.width());
    out.image.height = static_cast<int>(image.height());
    out.image.data.assign(image.data().begin(), image.data().end());
  }
  observation.proprioception.resize(message.proprioception_size());
  for (int i = 0; i < message.proprioception_size(); ++i) {
    RS_RETURN_IF_ERROR(CheckFinite(absl::StrCat("observation.proprioception[", i, "]"),
                                   message.proprioception(i)));
    observation.proprioception[i] = message.proprioception(i);
  }
  return observation;
}

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

absl::Status ToStatus(const robostress::v1::Refusal& refusal) {
  const int code = refusal.code();
  if (code <= 0 || code > 16) return Invalid("refusal.code is ", code, ", must be 1 to 16");
  return Refusal(absl::Status(static_cast<absl::StatusCode>(code), refusal.message()),
                 absl::Milliseconds(std::min(refusal.retry_after_ms(), kMaxRetryAfterMs)));
}

robostress::v1::Refusal ToRefusal(const absl::Status& status) {
  v1::Refusal message;
  message.set_code(static_cast<int>(status.code()));
  message.set_message(std::string(status.message().substr(0, kMaxRefusalMessage)));
  const int64_t retry_ms = absl::ToInt64Milliseconds(RetryAfter(status));
  message.set_retry_after_ms(
      static_cast<uint32_t>(std::clamp<int64_t>(retry_ms, 0, kMaxRetryAfterMs)));
  return message;
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

robostress::v1::GetStatsResponse ToProto(const SessionStats& stats) {
  v1::GetStatsResponse message;
  message.set_feedback_chunks(stats.feedback_chunks);
  message.set_updates_applied(stats.updates_applied);
  message.set_adapter_distance(stats.adapter_distance);
  message.set_last_loss(stats.last_loss);
  return message;
}

absl::StatusOr<SessionStats> FromProto(const robostress::v1::GetStatsResponse& message) {
  RS_RETURN_IF_ERROR(CheckFinite("stats.adapter_distance", message.adapter_distance()));
  RS_RETURN_IF_ERROR(CheckFinite("stats.last_loss", message.last_loss()));
  SessionStats stats;
  stats.feedback_chunks = message.feedback_chunks();
  stats.updates_applied = message.updates_applied();
  stats.adapter_distance = message.adapter_distance();
  stats.last_loss = message.last_loss();
  return stats;
}

}  // namespace robostress
