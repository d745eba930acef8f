#include "common/unit/unit_plan.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/rollout/policy_endpoint.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "common/unit/robots.h"

namespace robostress {
namespace {

constexpr std::string_view kMethod = "method.", kPreset = "method.method=", kSection = "method=";

absl::Status CheckRange(const char* key, int64_t value, int64_t low, int64_t high,
                        const char* hint) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat("unit: ", key, " is ", value, ", must be ", low, " to ", high, hint));
}

absl::Status CheckKnown(const char* what, const std::string& name,
                        const std::vector<std::string>& known) {
  if (std::find(known.begin(), known.end(), name) != known.end()) return absl::OkStatus();
  return absl::NotFoundError(
      absl::StrCat("unit: unknown ", what, " '", name, "'; known: ", absl::StrJoin(known, ", ")));
}

// A scenario of the Panda's has levels and joints; an arm is checked by who builds it.
absl::Status CheckScenario(const UnitConfig& unit, const RobotInfo& robot) {
  if (robot.arms.empty()) return MakeScenario(unit.scenario, unit.severity).status();
  if (IsScenarioFile(unit.scenario))
    return ReadScenarioFile(unit.scenario, robot.description).status();
  return CheckKnown("scenario", unit.scenario, ScenariosOf(robot));
}

// A method section: the preset that it names, base unless it does, and its other keys over that.
absl::StatusOr<MethodOptions> ReadSection(const std::string& source, YAML::Node section) {
  if (!section.IsMap()) {
    return absl::InvalidArgumentError(absl::StrCat(
        source, ": method must be a section such as {method: ours}; a preset is method.method"));
  }
  const YAML::Node name = std::as_const(section)["method"];
  if (name.IsDefined() && name.IsNull()) {
    return absl::InvalidArgumentError(absl::StrCat(
        source, ": method.method is YAML's null; for the method of that name write \"null\""));
  }
  if (!name.IsDefined()) section["method"] = "base";
  return ReadMethod(source + ": method", section);
}

}  // namespace

absl::StatusOr<UnitConfig> ReadUnit(const std::string& source, const std::string& yaml,
                                    const std::vector<std::string>& overrides) {
  RS_ASSIGN_OR_RETURN(UnitConfig unit, ParseConfig<UnitConfig>(source, yaml));
  const YAML::Node root = YAML::Load(yaml);  // parsed once already
  if (root.IsMap() && root["method"].IsDefined()) {
    RS_ASSIGN_OR_RETURN(unit.method, ReadSection(source, root["method"]));
  }
  // "method.method=ours" selects the preset before the other overrides change it.
  std::vector<std::string> of_method;
  for (const std::string& assignment : overrides) {
    if (assignment.starts_with(kPreset)) {
      RS_ASSIGN_OR_RETURN(unit.method, MakeMethod(assignment.substr(kPreset.size())));
    } else if (assignment.starts_with(kSection)) {
      RS_ASSIGN_OR_RETURN(const YAML::Node tree, config_internal::OverrideTree(assignment));
      RS_ASSIGN_OR_RETURN(unit.method,
                          ReadSection(absl::StrCat("override '", assignment, "'"), tree["method"]));
    } else if (assignment.starts_with(kMethod)) {
      of_method.push_back(assignment.substr(kMethod.size()));
    } else {
      RS_RETURN_IF_ERROR(ApplyOverrides({assignment}, unit));
    }
  }
  RS_RETURN_IF_ERROR(OverrideMethod(of_method, unit.method.Edit()));
  return unit;
}

absl::StatusOr<UnitConfig> ResolveUnit(const UnitConfig& unit) {
  if (!unit.libero_tasks.empty()) {
    RS_ASSIGN_OR_RETURN(const std::string name, AddTaskFolder(unit.libero_tasks));
    if (unit.suite != name) {
      return absl::InvalidArgumentError(
          absl::StrCat("unit: suite is '", unit.suite, "', and libero_tasks=", unit.libero_tasks,
                       " is suite '", name, "'; suite must be the folder's name"));
    }
  }
  const SuiteInfo* suite = FindSuite(unit.suite);
  RS_ASSIGN_OR_RETURN(const RobotInfo robot, FindRobot(unit.robot));
  RS_RETURN_IF_ERROR(CheckKnown("suite", unit.suite, SuitesOf(unit.robot)));
  RS_RETURN_IF_ERROR(CheckRange("severity", unit.severity, 1, 5, ""));
  RS_RETURN_IF_ERROR(CheckScenario(unit, robot));
  RS_RETURN_IF_ERROR(CheckKnown("method", unit.method->method, robot.methods));
  UnitConfig resolved = unit;
  if (resolved.tasks.empty()) {
    for (int task = 0; task < suite->num_tasks; ++task) resolved.tasks.push_back(task);
  }
  std::set<int> seen;
  for (const int task : resolved.tasks) {
    RS_RETURN_IF_ERROR(
        CheckRange("tasks", task, 0, suite->num_tasks - 1, "; see `robostress suites`"));
    if (!seen.insert(task).second) {
      return absl::InvalidArgumentError(absl::StrCat("unit: tasks lists task ", task, " twice"));
    }
  }
  const int states = suite->num_initial_states;
  RS_RETURN_IF_ERROR(
      CheckRange("first_initial_state", unit.first_initial_state, 0, states - 1, ""));
  const int sharing = suite->states_go_on ? static_cast<int>(resolved.tasks.size()) : 1;
  RS_RETURN_IF_ERROR(CheckRange("episodes", unit.episodes, 1,
                                (states - unit.first_initial_state) / sharing,
                                ": every episode of a task has an initial state of its own"));
  RS_RETURN_IF_ERROR(CheckRange("videos", unit.videos, 0, states, ""));
  RS_RETURN_IF_ERROR(CheckRange("sim.settle_steps", unit.sim.settle_steps, 0, 1000, ""));
  RS_RETURN_IF_ERROR(CheckRange("sim.sensing.delay", unit.sim.sensing.delay, 0, 100, ""));
  if (unit.sim.pictures != SimOptions::kOriginalPictures &&
      unit.sim.pictures != SimOptions::kPlainPictures) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: sim.pictures is '", unit.sim.pictures, "', must be original or plain"));
  }
  if (unit.sim.pictures == SimOptions::kPlainPictures && !suite->needs_libero) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: sim.pictures is 'plain', which is of LIBERO's views; suite '",
                     unit.suite, "' is drawn in one way only; leave it out"));
  }
  const double tanh_width = unit.sim.joint_errors.tanh_width;
  if (!(tanh_width > 0 && std::isfinite(tanh_width))) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: sim.joint_errors.tanh_width is ", tanh_width,
                     " rad/s, must be finite and above 0; 0.01 is usual"));
  }
  if (!(unit.sim.controller_kp >= 1 && unit.sim.controller_kp <= 2000)) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: sim.controller_kp is ", unit.sim.controller_kp, ", must be 1 to 2000"));
  }
  if (!(unit.sim.sensing.noise >= 0 && unit.sim.sensing.noise <= 0.1)) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: sim.sensing.noise is ", unit.sim.sensing.noise, ", must be 0 to 0.1"));
  }
  RS_RETURN_IF_ERROR(CheckRange("horizon", unit.horizon, 0, unit.robot == "panda" ? 10000 : 0,
                                ": control steps of the simulated panda; 0: the suite's"));
  if (unit.policy.empty()) return absl::InvalidArgumentError("unit: policy is empty");
  RS_RETURN_IF_ERROR(CheckLatency(unit));
  if (RunsInWorker(unit.policy) && unit.method->method != "base") {
    return absl::InvalidArgumentError(absl::StrCat("unit: policy '", unit.policy,
                                                   "' has nothing to adapt, method is '",
                                                   unit.method->method, "', must be 'base'"));
  }
  return resolved;
}

absl::Status CheckLatency(const UnitConfig& unit) {
  const LatencyOptions& latency = unit.latency;
  RS_RETURN_IF_ERROR(CheckRange("latency.ms", latency.ms, 0, 10000, ""));
  RS_RETURN_IF_ERROR(CheckRange("latency.late_steps", latency.late_steps, 0, 1000, ""));
  RS_RETURN_IF_ERROR(CheckRange("latency.fade_steps", latency.fade_steps, 0, 1000, ""));
  RS_RETURN_IF_ERROR(CheckRange("latency.guide_rows", latency.guide_rows, 0, 1000, ""));
  if (!(latency.moved_bound >= 0 && latency.moved_bound <= 1000)) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: latency.moved_bound is ", latency.moved_bound, ", must be 0 to 1000"));
  }
  if (latency.used() && unit.robot != "panda") {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: latency is simulated for the panda, the robot is ", unit.robot,
                     "; its client's is client.latency_ticks"));
  }
  if (latency.late() && unit.method->every_step) {
    return absl::InvalidArgumentError(
        absl::StrCat("unit: method ", unit.method->method,
                     " corrects every step of the newest chunk, which "
                     "does not play yet where answers take ",
                     latency.ms, " ms; take one that corrects a chunk at once, as ours_following"));
  }
  if (latency.late() && unit.method->execute_steps != 0) {
    return absl::InvalidArgumentError(absl::StrCat(
        "unit: method ", unit.method->method, " has execute_steps ", unit.method->execute_steps,
        ", and where answers take time the policy's own count; leave one of the two out"));
  }
  if (latency.late() && latency.mode == LateChunks::kRtc &&
      (RunsInWorker(unit.policy) || unit.remote.used())) {
    return absl::InvalidArgumentError(InpaintingError(unit.policy).message());
  }
  return absl::OkStatus();
}

std::vector<PlannedEpisode> PlanEpisodes(const UnitConfig& resolved) {
  std::vector<PlannedEpisode> plan;
  const SuiteInfo* suite = FindSuite(resolved.suite);
  const bool go_on = suite != nullptr && suite->states_go_on;
  int first = resolved.first_initial_state;
  for (const int task : resolved.tasks) {
    for (int episode = 0; episode < resolved.episodes; ++episode)
      plan.push_back({task, episode, first + episode, episode < resolved.videos});
    if (go_on) first += resolved.episodes;
  }
  return plan;
}

absl::StatusOr<std::vector<PlannedEpisode>> PlanRange(const UnitConfig& resolved,
                                                      const std::string& range) {
  std::vector<PlannedEpisode> plan = PlanEpisodes(resolved);
  if (range.empty()) return plan;
  const std::vector<std::string> ends = absl::StrSplit(range, '-');
  size_t first = 0, last = 0;
  if (ends.size() != 2 || !absl::SimpleAtoi(ends[0], &first) || !absl::SimpleAtoi(ends[1], &last) ||
      first > last || last >= plan.size()) {
    return absl::InvalidArgumentError(
        absl::StrCat("episodes '", range, "' is no range FIRST-LAST within 0-", plan.size() - 1));
  }
  if (!MayBeDivided(resolved)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "episodes '", range, "': ",
        resolved.method->CarriesOver()
            ? absl::StrCat("method '", resolved.method->method, "' carries what it learned")
            : absl::StrCat("robot '", resolved.robot, "' carries where its arm stands"),
        " from episode to episode; run the whole unit"));
  }
  return std::vector<PlannedEpisode>(plan.begin() + first, plan.begin() + last + 1);
}

bool MayBeDivided(const UnitConfig& unit) {
  const absl::StatusOr<RobotInfo> robot = FindRobot(unit.robot);
  return robot.ok() && robot->episodes_stand_alone && !unit.method->CarriesOver();
}

EpisodeIdentity IdentityOf(const UnitConfig& resolved, const PlannedEpisode& planned) {
  return {.suite = resolved.suite,
          .scenario = ScenarioLabel(resolved.scenario),
          .policy = resolved.policy,
          .method = resolved.method->method,
          .severity = resolved.severity,
          .seed = resolved.seed,
          .task = planned.task,
          .episode = planned.episode,
          .initial_state = planned.initial_state};
}

bool RunsInWorker(const std::string& policy) { return policy == "expert" || policy == "replay"; }

}  // namespace robostress
