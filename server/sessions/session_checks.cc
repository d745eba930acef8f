#include "server/sessions/session_checks.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/embedded_policies.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

absl::Status CheckMethod(const MethodOptions& m, const PolicySpec& policy) {
  const std::vector<std::string> names = MethodNames();
  const auto invalid = [&m](const auto&... parts) {
    return absl::InvalidArgumentError(absl::StrCat("method ", m.method, ": ", parts...));
  };
  if (!absl::c_linear_search(names, m.method)) {
    return absl::NotFoundError(
        absl::StrCat("unknown method '", m.method, "'; known: ", absl::StrJoin(names, ", ")));
  }
  if (m.adapt && !policy.adaptable)
    return invalid("policy ", policy.name, " has no layers to adapt; use base");
  if (m.adapt && m.direct)
    return invalid("adapt and direct exclude each other; set one of them to false");
  if (m.direct && (m.integral_rate > 0 || m.following_gain > 0))
    return invalid(
        "direct and integral_rate or following_gain exclude each other; set direct to false or "
        "these to 0");
  if (m.buffer_chunks < 1 || m.buffer_chunks > 4096)
    return invalid("buffer_chunks is ", m.buffer_chunks, ", must be 1..4096");
  if (m.update_interval < 1)
    return invalid("update_interval is ", m.update_interval, ", must be at least 1");
  if (m.batch < 1 || m.batch > m.buffer_chunks) {
    return invalid("batch is ", m.batch, ", must be 1..", m.buffer_chunks, " (buffer_chunks)");
  }
  const auto in_range = [](double value, double low, double high) {
    return value >= low && value <= high;
  };
  if (!in_range(m.learning_rate, 0, 1))
    return invalid("learning_rate is ", m.learning_rate, ", must be 0..1");
  if (!in_range(m.lora_init_std, 0, 10))
    return invalid("lora_init_std is ", m.lora_init_std, ", must be 0..10");
  if (!in_range(m.beta1, 0, 1) || m.beta1 == 1)
    return invalid("beta1 is ", m.beta1, ", must be in [0, 1)");
  if (!in_range(m.beta2, 0, 1) || m.beta2 == 1)
    return invalid("beta2 is ", m.beta2, ", must be in [0, 1)");
  if (!in_range(m.adam_epsilon, 1e-30, 1))
    return invalid("adam_epsilon is ", m.adam_epsilon, ", must be above 0, at most 1");
  if (!in_range(m.clip_norm, 1e-12, 1e12))
    return invalid("clip_norm is ", m.clip_norm, ", must be above 0");
  if (!in_range(m.anchor_weight, 0, 1e6))
    return invalid("anchor_weight is ", m.anchor_weight, ", must be 0 or above");
  if (!in_range(m.integral_rate, 0, 1))
    return invalid("integral_rate is ", m.integral_rate, ", must be 0..1");
  if (!in_range(m.integral_limit, 0, 10))
    return invalid("integral_limit is ", m.integral_limit, ", must be 0..10");
  if (!in_range(m.integral_threshold, 0, 10))
    return invalid("integral_threshold is ", m.integral_threshold, ", must be 0..10");
  if (!in_range(m.following_gain, 0, 10))
    return invalid("following_gain is ", m.following_gain, ", must be 0..10");
  if (!in_range(m.following_memory, 1, 1e6))
    return invalid("following_memory is ", m.following_memory, ", must be 1..1e6");
  if (!in_range(m.following_threshold, 0, 10))
    return invalid("following_threshold is ", m.following_threshold, ", must be 0..10");
  if (!in_range(m.following_limit, 0, 10))
    return invalid("following_limit is ", m.following_limit, ", must be 0..10");
  if (!in_range(m.gain, -100, 100)) return invalid("gain is ", m.gain, ", must be in -100..100");
  if (!in_range(m.tracking_gain, 1e-3, 100))
    return invalid("tracking_gain is ", m.tracking_gain, ", must be 0.001..100");
  return absl::OkStatus();
}

}  // namespace

MethodCaps Tightest(const MethodCaps& a, const MethodCaps& b) {
  return {std::min(a.max_rank, b.max_rank), std::min(a.max_batch, b.max_batch),
          std::max(a.min_update_interval, b.min_update_interval),
          std::min(a.max_buffer_chunks, b.max_buffer_chunks)};
}

absl::Status CheckMethodCaps(const MethodOptions& method, const MethodCaps& caps) {
  if (!method.adapt) return absl::OkStatus();
  struct Cap {
    const char *option, *flag;
    int value, limit;
    bool is_minimum;
  };
  const Cap limits[] = {{"rank", "--max-rank", method.rank, caps.max_rank, false},
                        {"batch", "--max-update-batch", method.batch, caps.max_batch, false},
                        {"update_interval", "--min-update-interval", method.update_interval,
                         caps.min_update_interval, true},
                        {"buffer_chunks", "--max-buffer-chunks", method.buffer_chunks,
                         caps.max_buffer_chunks, false}};
  for (const Cap& cap : limits) {
    if (cap.is_minimum ? cap.value >= cap.limit : cap.value <= cap.limit) continue;
    return absl::InvalidArgumentError(absl::StrCat(
        "method ", method.method, ": ", cap.option, " is ", cap.value, ", at ",
        cap.is_minimum ? "least " : "most ", cap.limit,
        " is allowed here; the operator sets it with ", cap.flag, ", or for the token"));
  }
  return absl::OkStatus();
}

namespace {

bool NeedsControlSpace(const MethodOptions& method) {
  return method.adapt || method.direct || method.integral_rate > 0 || method.following_gain > 0 ||
         method.gain != 1.0;
}

}  // namespace

absl::StatusOr<ControlSpace> ControlSpaceOf(const SessionSpec& spec, const PolicySpec& policy) {
  const ControlSpace robot = spec.control_space, said = policy.control_space;
  const auto name = [](ControlSpace space) {
    return space == ControlSpace::kJoint ? "joint targets" : "end-effector displacements";
  };
  if (robot == ControlSpace::kUnspecified && said == ControlSpace::kUnspecified) {
    if (!NeedsControlSpace(spec.method)) return ControlSpace::kEndEffector;
    return absl::InvalidArgumentError(absl::StrCat(
        "method ", spec.method.method, " learns from motion or changes commands, and policy '",
        policy.name,
        "' does not say what its actions are: give control_space, end_effector or joint"));
  }
  if (robot == ControlSpace::kUnspecified) return said;
  if (said != ControlSpace::kUnspecified && said != robot) {
    return absl::InvalidArgumentError(absl::StrCat(
        "policy '", policy.name, "' commands ", name(said), ", robot '", spec.robot, "' takes ",
        name(robot), ": serve one that does, as `robostress serve --policy ",
        robot == ControlSpace::kJoint ? kPiperPolicy : kSuitePolicies[0].data(), "`"));
  }
  return robot;
}

absl::Status CheckSessionSpec(const SessionSpec& spec, const PolicySpec& policy) {
  RS_RETURN_IF_ERROR(CheckMethod(spec.method, policy));
  // Motion is divided by these: below, what a robot can do would pass what a number can hold.
  const std::pair<const char*, double> scales[] = {{"translation_scale", spec.translation_scale},
                                                   {"rotation_scale", spec.rotation_scale},
                                                   {"control_period_s", spec.control_period_s}};
  for (const auto& [field, value] : scales) {
    if (value >= 1e-6 && value <= 100) continue;
    return absl::InvalidArgumentError(absl::StrCat(field, " is ", value, ", must be 1e-6..100"));
  }
  if (ActsInJointSpace(spec) && spec.method.target == TargetReference::kNominal) {
    return absl::InvalidArgumentError(
        absl::StrCat("method ", spec.method.method,
                     ": target nominal models an end-effector "
                     "controller; robot ",
                     spec.robot, " acts in joint space: use target executed or intent"));
  }
  if (ActsInJointSpace(spec) && spec.method.gain != 1.0) {
    return absl::InvalidArgumentError(
        absl::StrCat("method ", spec.method.method, ": gain ", spec.method.gain,
                     " would scale absolute joint targets; robot ", spec.robot, " needs gain 1"));
  }
  if (ActsInJointSpace(spec) && (spec.method.integral_rate > 0 || spec.method.following_gain > 0)) {
    return absl::InvalidArgumentError(
        absl::StrCat("method ", spec.method.method, ": ",
                     spec.method.following_gain > 0 ? "model following" : "integral action",
                     " compares with a nominal end-effector controller; robot ", spec.robot,
                     " acts in joint space: use the disturbance observer of its client"));
  }
  return absl::OkStatus();
}

}  // namespace robostress
