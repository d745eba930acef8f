#include "server/wire/openpi/openpi_extensions.h"

#include <cmath>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/rollout/message_limits.h"
#include "common/rollout/spec_checks.h"
#include "common/status_macros.h"
#include "common/wire/openpi_readers.h"

namespace robostress {
namespace {

absl::StatusOr<double> ReadPositive(const std::string& field, const OpenpiValue& value) {
  RS_ASSIGN_OR_RETURN(const std::vector<double> numbers, OpenpiNumbers(field, value, 1));
  if (numbers.size() != 1 || numbers[0] <= 0 || numbers[0] > 1e6)
    return absl::InvalidArgumentError(absl::StrCat(field, ": must be one number above 0"));
  return numbers[0];
}

// Refuses keys that are not in `known`.
absl::Status CheckKeys(const char* field, const OpenpiValue& value,
                       const std::vector<std::string>& known) {
  if (value.map() == nullptr)
    return absl::InvalidArgumentError(absl::StrCat(field, ": must be a map"));
  for (const auto& [key, ignored] : *value.map()) {
    if (!absl::c_linear_search(known, key))
      return absl::InvalidArgumentError(absl::StrCat(field, ": unknown key '", key.substr(0, 64),
                                                     "'; known: ", absl::StrJoin(known, ", ")));
  }
  return absl::OkStatus();
}

}  // namespace

absl::StatusOr<SessionSpec> ReadOpenpiSession(const OpenpiValue& session,
                                              const SessionSpec& defaults) {
  RS_RETURN_IF_ERROR(
      CheckKeys("session", session,
                {"robot", "suite", "scenario", "severity", "policy", "seed", "mode",
                 "control_space", "goal_reference", "method", "method_options", "control_period_s",
                 "translation_scale", "rotation_scale", "resize"}));
  SessionSpec spec = defaults;
  for (const auto& [key, field] : {std::pair<const char*, std::string*>{"robot", &spec.robot},
                                   {"suite", &spec.suite},
                                   {"scenario", &spec.scenario},
                                   {"policy", &spec.policy}}) {
    if (const OpenpiValue* value = session.Find(key)) {
      RS_ASSIGN_OR_RETURN(*field,
                          OpenpiText(absl::StrCat("session/", key), *value, WireLimits::kName));
    }
  }
  if (const OpenpiValue* value = session.Find("severity")) {
    RS_ASSIGN_OR_RETURN(const int64_t severity, OpenpiInteger("session/severity", *value, 1, 5));
    spec.severity = static_cast<int>(severity);
  }
  if (const OpenpiValue* value = session.Find("seed")) {
    RS_ASSIGN_OR_RETURN(spec.seed, OpenpiInteger("session/seed", *value, INT64_MIN, INT64_MAX));
  }
  if (const OpenpiValue* value = session.Find("mode")) {
    RS_ASSIGN_OR_RETURN(const std::string mode, OpenpiText("session/mode", *value, 16));
    if (mode != "lockstep" && mode != "async")
      return absl::InvalidArgumentError("session/mode: must be lockstep or async");
    spec.mode = mode == "async" ? ExecutionMode::kAsync : ExecutionMode::kLockstep;
  }
  if (const OpenpiValue* value = session.Find("control_space")) {
    RS_ASSIGN_OR_RETURN(const std::string space, OpenpiText("session/control_space", *value, 16));
    if (space != "end_effector" && space != "joint")
      return absl::InvalidArgumentError("session/control_space: must be end_effector or joint");
    spec.control_space = space == "joint" ? ControlSpace::kJoint : ControlSpace::kEndEffector;
  }
  if (const OpenpiValue* value = session.Find("goal_reference")) {
    RS_ASSIGN_OR_RETURN(const std::string goal, OpenpiText("session/goal_reference", *value, 16));
    if (goal != "achieved" && goal != "desired")
      return absl::InvalidArgumentError("session/goal_reference: must be achieved or desired");
    spec.goal_reference = goal == "desired" ? GoalReference::kDesired : GoalReference::kAchieved;
  }
  for (const auto& [key, field] :
       {std::pair<const char*, double*>{"control_period_s", &spec.control_period_s},
        {"translation_scale", &spec.translation_scale},
        {"rotation_scale", &spec.rotation_scale}}) {
    if (const OpenpiValue* value = session.Find(key)) {
      RS_ASSIGN_OR_RETURN(*field, ReadPositive(absl::StrCat("session/", key), *value));
    }
  }
  std::vector<std::string> overrides;
  if (const OpenpiValue* value = session.Find("method_options")) {
    const auto* list = std::get_if<OpenpiValue::List>(&value->value);
    if (list == nullptr || list->size() > 64)
      return absl::InvalidArgumentError(
          "session/method_options: must be a list of at most 64 texts key=value");
    for (size_t i = 0; i < list->size(); ++i) {
      RS_ASSIGN_OR_RETURN(
          overrides.emplace_back(),
          OpenpiText(absl::StrCat("session/method_options[", i, "]"), (*list)[i], 256));
    }
  }
  if (const OpenpiValue* value = session.Find("method")) {
    RS_ASSIGN_OR_RETURN(const std::string method,
                        OpenpiText("session/method", *value, WireLimits::kName));
    absl::StatusOr<MethodOptions> made = MakeMethod(method, overrides);
    if (!made.ok()) {
      return absl::InvalidArgumentError(
          absl::StrCat("session/method, method_options: ", made.status().message()));
    }
    spec.method = *std::move(made);
  } else if (!overrides.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat("session/method_options: without session/method they change no known method; "
                     "name one of: ",
                     absl::StrJoin(MethodNames(), ", ")));
  }
  // The same checks as of a session that comes over gRPC, under this wire's names.
  if (const absl::Status checked = CheckSessionSpec(spec); !checked.ok()) {
    return absl::InvalidArgumentError(
        absl::StrReplaceAll(checked.message(), {{"spec.", "session/"}}));
  }
  return spec;
}

absl::StatusOr<OpenpiResume> ReadOpenpiResume(const OpenpiValue& session) {
  RS_RETURN_IF_ERROR(CheckKeys("session", session, {"resume", "resize"}));
  const OpenpiValue& resume = *session.Find("resume");
  const OpenpiValue *id = resume.Find("id"), *token = resume.Find("token");
  if (id == nullptr || token == nullptr)
    return absl::InvalidArgumentError("session/resume: must be {id, token} of an earlier reply");
  OpenpiResume result;
  RS_ASSIGN_OR_RETURN(result.id, OpenpiText("session/resume/id", *id, 256));
  RS_ASSIGN_OR_RETURN(result.token, OpenpiText("session/resume/token", *token, 256));
  return result;
}

absl::StatusOr<bool> ReadOpenpiResize(const OpenpiValue& session, bool fallback) {
  const OpenpiValue* value = session.Find("resize");
  if (value == nullptr) return fallback;
  const bool* flag = std::get_if<bool>(&value->value);
  if (flag == nullptr) return absl::InvalidArgumentError("session/resize: must be true or false");
  return *flag;
}

absl::StatusOr<RunningRows> ReadOpenpiRunning(const OpenpiValue& value, const PolicySpec& policy) {
  RS_RETURN_IF_ERROR(CheckKeys("running", value, {"actions", "held"}));
  const OpenpiValue *actions = value.Find("actions"), *held = value.Find("held");
  if (actions == nullptr || held == nullptr) {
    return absl::InvalidArgumentError(absl::StrCat(
        "running/", actions == nullptr ? "actions" : "held",
        ": is missing; give the rows that are left of the running chunk, and how many are held"));
  }
  RS_ASSIGN_OR_RETURN(
      const Eigen::MatrixXd rows,
      OpenpiMatrix("running/actions", *actions, {1, policy.horizon}, policy.action_dim));
  RunningRows running;
  running.actions = rows.cast<float>();
  RS_ASSIGN_OR_RETURN(const int64_t number, OpenpiInteger("running/held", *held, 0, rows.rows()));
  running.held = static_cast<int>(number);
  return running;
}

absl::StatusOr<OpenpiExecuted> ReadOpenpiExecuted(const OpenpiValue& value,
                                                  const PolicySpec& policy,
                                                  double control_period_s) {
  RS_RETURN_IF_ERROR(
      CheckKeys("executed", value,
                {"sequence", "prediction_id", "first_step", "last_of_episode", "sent_commands",
                 "stamp_s", "q", "dq", "p_base_tool", "q_base_tool", "gripper"}));
  OpenpiExecuted executed;
  const auto integer = [&value](const char* key, int64_t low, int64_t high,
                                int64_t fallback) -> absl::StatusOr<int64_t> {
    const OpenpiValue* found = value.Find(key);
    if (found == nullptr) return fallback;
    return OpenpiInteger(absl::StrCat("executed/", key), *found, low, high);
  };
  RS_ASSIGN_OR_RETURN(const int64_t sequence, integer("sequence", 1, INT64_MAX, 0));
  RS_ASSIGN_OR_RETURN(const int64_t prediction, integer("prediction_id", 1, INT64_MAX, 0));
  RS_ASSIGN_OR_RETURN(const int64_t first, integer("first_step", 0, WireLimits::kHorizon, 0));
  executed.sequence = static_cast<uint64_t>(sequence);
  executed.prediction_id = static_cast<uint64_t>(prediction);
  executed.first_step = static_cast<int>(first);
  if (const OpenpiValue* last = value.Find("last_of_episode")) {
    const bool* flag = std::get_if<bool>(&last->value);
    if (flag == nullptr)
      return absl::InvalidArgumentError("executed/last_of_episode: must be true or false");
    executed.last_of_episode = *flag;
  }
  const OpenpiValue* joints = value.Find("q");
  if (joints == nullptr) return absl::InvalidArgumentError("executed/q: is missing");
  RS_ASSIGN_OR_RETURN(
      const Eigen::MatrixXd q,
      OpenpiMatrix("executed/q", *joints, {2, policy.horizon + 1}, {1, WireLimits::kDof}));
  const auto rows = static_cast<int>(q.rows());
  const auto matrix = [&](const char* key, int r, int cols,
                          const Eigen::MatrixXd& fallback) -> absl::StatusOr<Eigen::MatrixXd> {
    const OpenpiValue* found = value.Find(key);
    if (found == nullptr) return fallback;
    return OpenpiMatrix(absl::StrCat("executed/", key), *found, r, cols);
  };
  const auto column = [&](const char* key,
                          const Eigen::VectorXd& fallback) -> absl::StatusOr<Eigen::VectorXd> {
    const OpenpiValue* found = value.Find(key);
    if (found == nullptr) return fallback;
    if (const size_t count = OpenpiCount(*found); count != static_cast<size_t>(rows)) {
      return absl::InvalidArgumentError(absl::StrCat(
          "executed/", key, ": holds ", count, " numbers, must be ", rows, ", as q has rows"));
    }
    RS_ASSIGN_OR_RETURN(const std::vector<double> numbers,
                        OpenpiNumbers(absl::StrCat("executed/", key), *found, rows));
    return Eigen::VectorXd(Eigen::Map<const Eigen::VectorXd>(numbers.data(), rows));
  };
  const auto dof = static_cast<int>(q.cols());
  Eigen::MatrixXd upright = Eigen::MatrixXd::Zero(rows, 4);
  upright.col(0).setOnes();
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXd dq,
                      matrix("dq", rows, dof, Eigen::MatrixXd::Zero(rows, dof)));
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXd p,
                      matrix("p_base_tool", rows, 3, Eigen::MatrixXd::Zero(rows, 3)));
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXd r, matrix("q_base_tool", rows, 4, upright));
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXd sent,
                      matrix("sent_commands", rows - 1, policy.action_dim, Eigen::MatrixXd()));
  RS_ASSIGN_OR_RETURN(
      const Eigen::VectorXd stamps,
      column("stamp_s", Eigen::VectorXd::LinSpaced(rows, 0, (rows - 1) * control_period_s)));
  RS_ASSIGN_OR_RETURN(const Eigen::VectorXd gripper,
                      column("gripper", Eigen::VectorXd::Zero(rows)));
  executed.sent_commands = sent.cast<float>();
  if (!executed.sent_commands.allFinite())
    return absl::InvalidArgumentError("executed/sent_commands: a value is beyond float32");
  for (int i = 0; i < rows; ++i) {
    RobotState state;
    state.stamp_s = stamps[i];
    state.q = q.row(i);
    state.dq = dq.row(i);
    state.tool.p_base_tool = p.row(i);
    state.tool.q_base_tool = Eigen::Quaterniond(r(i, 0), r(i, 1), r(i, 2), r(i, 3));
    state.gripper = gripper[i];
    if (std::abs(state.tool.q_base_tool.norm() - 1) > WireLimits::kQuaternionNormError)
      return absl::InvalidArgumentError(absl::StrCat("executed/q_base_tool[", i, "] has norm ",
                                                     state.tool.q_base_tool.norm(), ", must be 1"));
    executed.states.push_back(std::move(state));
  }
  return executed;
}

}  // namespace robostress
