#include "server/sessions/session_checks.h"

#include <algorithm>
#include <string>
#include <utility>
#include <vector>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/embedded_policies.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

absl::Status CheckMethod(const MethodOptions& m, const PolicySpec& policy) {
  const std::vector<std::string> names = MethodNames();
  if (!absl::c_linear_search(names, m.method)) {
    return absl::NotFoundError(
        absl::StrCat("unknown method '", m.method, "'; known: ", absl::StrJoin(names, ", ")));
  }
  if (m.adapts() && !policy.adaptable) {
    return absl::InvalidArgumentError(absl::StrCat("method ", m.method, ": policy ", policy.name,
                                                   " has no layers to adapt; use base"));
  }
  return m.Check();
}

}  // namespace

MethodCaps Tightest(const MethodCaps& a, const MethodCaps& b) {
  return {std::min(a.max_rank, b.max_rank), std::min(a.max_batch, b.max_batch),
          std::max(a.min_update_interval, b.min_update_interval),
          std::min(a.max_buffer_chunks, b.max_buffer_chunks)};
}

absl::Status CheckMethodCaps(const MethodOptions& method, const MethodCaps& caps) {
  const LoraOptions* lora = method.Find<LoraOptions>();
  if (lora == nullptr) return absl::OkStatus();
  struct Cap {
    const char *option, *flag;
    int value, limit;
    bool is_minimum;
  };
  const Cap limits[] = {
      {"rank", "--max-rank", lora->rank, caps.max_rank, false},
      {"batch", "--max-update-batch", lora->batch, caps.max_batch, false},
      {"update_interval", "--min-update-interval", lora->update_interval, caps.min_update_interval,
       true},
      {"buffer_chunks", "--max-buffer-chunks", lora->buffer_chunks, caps.max_buffer_chunks, false}};
  for (const Cap& cap : limits) {
    if (cap.is_minimum ? cap.value >= cap.limit : cap.value <= cap.limit) continue;
    return absl::InvalidArgumentError(absl::StrCat(
        "method ", method.method, ": ", cap.option, " is ", cap.value, ", at ",
        cap.is_minimum ? "least " : "most ", cap.limit,
        " is allowed here; the operator sets it with ", cap.flag, ", or for the token"));
  }
  return absl::OkStatus();
}

absl::StatusOr<ControlSpace> ControlSpaceOf(const SessionSpec& spec, const PolicySpec& policy) {
  const ControlSpace robot = spec.control_space, said = policy.control_space;
  const auto name = [](ControlSpace space) {
    return space == ControlSpace::kJoint ? "joint targets" : "end-effector displacements";
  };
  if (robot == ControlSpace::kUnspecified && said == ControlSpace::kUnspecified) {
    if (!spec.method->Compensates() && spec.method->gain == 1.0) return ControlSpace::kEndEffector;
    return absl::InvalidArgumentError(absl::StrCat(
        "method ", spec.method->method, " learns from motion or changes commands, and policy '",
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
  RS_RETURN_IF_ERROR(CheckMethod(*spec.method, policy));
  RS_RETURN_IF_ERROR(CheckScales(spec));
  if (spec.method->every_step) {
    return absl::InvalidArgumentError(absl::StrCat(
        "method ", spec.method->method,
        ": every_step is done beside the arm, not in a server; leave it out, or let the robot's "
        "client correct around a session of method base"));
  }
  if (ActsInJointSpace(spec)) return spec.method->CheckJointSpace(spec.robot);
  return absl::OkStatus();
}

}  // namespace robostress
