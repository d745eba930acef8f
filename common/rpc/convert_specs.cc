#include "common/rpc/convert_specs.h"

#include <string>
#include <utility>

#include "common/rollout/field_checks.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

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

absl::StatusOr<RequestedSession> FromProto(const robostress::v1::SessionSpec& message) {
  RS_RETURN_IF_ERROR(CheckRange("spec.severity", message.severity(), 1, 5));
  RS_RETURN_IF_ERROR(CheckText("spec.method_yaml", message.method_yaml(), WireLimits::kMethodYaml));
  RequestedSession spec;
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
  spec.method_yaml = message.method_yaml();
  RS_RETURN_IF_ERROR(CheckSessionSpec(spec));
  return spec;
}

robostress::v1::SessionSpec ToProto(const RequestedSession& spec) {
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
  message.set_method_yaml(spec.method_yaml);
  message.set_control_period_s(spec.control_period_s);
  message.set_translation_scale(spec.translation_scale);
  message.set_rotation_scale(spec.rotation_scale);
  return message;
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
  message.set_inpaints(spec.inpaints);
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
  spec.inpaints = message.inpaints();
  RS_RETURN_IF_ERROR(CheckActionRange(spec));
  return spec;
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

}  // namespace robostress
