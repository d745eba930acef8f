#include "eval/close_loop/close_loop.h"

#include <cstdio>
#include <filesystem>
#include <map>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/statistics.h"
#include "common/status_macros.h"
#include "eval/close_loop/recorded_run.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using calibration::ReplayComparison;
using calibration::ReplayError;
using Json = nlohmann::ordered_json;

constexpr char kCommand[] = "close-loop";
constexpr int kDevSplit = 40;  // first initial state

// Whether an episode succeeded, by (task, initial state).
using Outcomes = std::map<std::pair<int, int>, bool>;

Outcomes OutcomesOf(const RunData& run, const std::string& scenario) {
  Outcomes outcomes;
  for (const UnitResult& unit : run.units) {
    if (ScenarioLabel(unit.config.scenario) != scenario) continue;
    for (const EpisodeRow& row : unit.episodes)
      outcomes[{row.task, row.initial_state}] = row.success;
  }
  return outcomes;
}

SuccessRate RateOf(const Outcomes& outcomes) {
  SuccessRate rate;
  for (const auto& [episode, success] : outcomes) {
    rate.successes += success;
    ++rate.episodes;
  }
  return rate;
}

Agreement Agree(const Outcomes& a, const Outcomes& b) {
  Agreement agreement;
  for (const auto& [episode, success] : a) {
    const auto other = b.find(episode);
    if (other == b.end()) continue;
    agreement.same += other->second == success;
    ++agreement.episodes;
  }
  return agreement;
}

class Circle {
 public:
  explicit Circle(const CloseLoopOptions& options) : options_(options) {}

  absl::StatusOr<CloseLoopResult> Run() {
    RS_ASSIGN_OR_RETURN(const ScenarioFile hidden, ReadHidden(options_.hidden, kPanda));
    result_.hidden = hidden.effects;
    RS_RETURN_IF_ERROR(KeepOptions());
    RS_RETURN_IF_ERROR(Record());
    RS_RETURN_IF_ERROR(MakeRig());
    RS_RETURN_IF_ERROR(Calibrate());
    RS_RETURN_IF_ERROR(Replay());
    RS_RETURN_IF_ERROR(Evaluate());
    RS_RETURN_IF_ERROR(WriteFileAtomically(Out("summary.json"), Summary().dump(2) + "\n"));
    return result_;
  }

 private:
  std::string Out(const std::string& name) const {
    return (fs::path(options_.out) / name).string();
  }

  // Runs a sweep of the options' tasks.
  absl::StatusOr<RunData> RunTasks(const std::string& folder, SweepGrid grid,
                                   bool record_joints) const {
    grid.suites = {options_.suite};
    grid.tasks = options_.tasks;
    grid.methods = {"base"};
    grid.severities = {options_.severity};
    return RunWholeGrid(kCommand, std::move(grid), Out(folder), options_.workers, record_joints);
  }

  absl::Status KeepOptions() const {
    const Json json = {{"hidden", HiddenPlace(options_.hidden)},
                       {"suite", options_.suite},
                       {"tasks", options_.tasks},
                       {"episodes", options_.episodes},
                       {"severity", options_.severity},
                       {"policy", options_.policy},
                       {"evaluated_episodes", options_.evaluated_episodes},
                       {"rate_hz", options_.rate_hz},
                       {"surrogates", options_.surrogates},
                       {"seed", options_.seed}};
    return KeepCircleOptions(Out("options.json"), json);
  }

  absl::Status Record() {
    SweepGrid grid;
    grid.scenarios = {options_.hidden};
    grid.policies = {"expert"};
    grid.episodes = options_.episodes;
    grid.first_initial_state = kDevSplit;
    return RunTasks("recording", grid, true).status();
  }

  absl::Status MakeRig() {
    RS_ASSIGN_OR_RETURN(
        recorded_, MakeRecordedRig(Out("recording"), options_.rate_hz, options_.seed, Out("rig")));
    result_.rig = recorded_.rig;
    return absl::OkStatus();
  }

  absl::Status Calibrate() {
    RS_RETURN_IF_ERROR(RunCalibration(kCommand, Out("rig/rig.yaml"), Out("calibration"),
                                      Out("calibration.log"), options_.surrogates, options_.seed));
    RS_ASSIGN_OR_RETURN(result_.found, ReadFoundEffects(Out("rig/rig.yaml"), Out("calibration"),
                                                        Out("found.yaml"), kPanda));
    RS_ASSIGN_OR_RETURN(const calibration::Rig declared, calibration::ReadRig(Out("rig/rig.yaml")));
    for (const calibration::RigLog& log : declared.logs) {
      if (log.role != calibration::LogRole::kFit) unseen_.insert(log.condition);
    }
    return absl::OkStatus();
  }

  std::string Found() const { return result_.found.effects.empty() ? "clean" : Out("found.yaml"); }

  absl::Status Replay() {
    std::vector<JointLog> unseen;
    for (const auto& [name, log] : recorded_.logs) {
      if (unseen_.count(name) > 0) unseen.push_back(log);
    }
    result_.replayed_episodes = static_cast<int>(unseen.size());
    RS_ASSIGN_OR_RETURN(result_.replay_before,
                        calibration::CompareReplays(unseen, "clean", recorded_.contact_limit_N));
    RS_ASSIGN_OR_RETURN(result_.replay_after,
                        calibration::CompareReplays(unseen, Found(), recorded_.contact_limit_N));
    return absl::OkStatus();
  }

  absl::Status Evaluate() {
    SweepGrid grid;
    grid.scenarios = {"clean"};
    if (options_.hidden != kNothingHidden) grid.scenarios.push_back(options_.hidden);
    if (!result_.found.effects.empty()) grid.scenarios.push_back(Found());
    grid.policies = {options_.policy};
    grid.episodes = options_.evaluated_episodes;
    RS_ASSIGN_OR_RETURN(const RunData run, RunTasks("evaluation", grid, false));
    const Outcomes clean = OutcomesOf(run, "clean");
    const Outcomes hidden = OutcomesOf(run, ScenarioLabel(options_.hidden));
    const Outcomes found = OutcomesOf(run, ScenarioLabel(Found()));
    result_.clean = RateOf(clean);
    result_.under_hidden = RateOf(hidden);
    result_.under_found = RateOf(found);
    result_.clean_agrees = Agree(clean, hidden);
    result_.found_agrees = Agree(found, hidden);
    return absl::OkStatus();
  }

  static Json ReplayJson(const ReplayComparison& comparison) {
    const auto error = [](const ReplayError& e) {
      return Json{{"joint_rad", e.joint_rad}, {"tool_m", e.tool_m}, {"steps", e.steps}};
    };
    return {{"free_motion", error(comparison.free_motion)}, {"whole", error(comparison.whole)}};
  }
  Json Summary() const {
    Json json = {{"verdict", result_.found.verdict},
                 {"recorded_episodes", result_.rig.episodes},
                 {"free_motion_s", result_.rig.seconds},
                 {"left_out_s", result_.rig.seconds_left_out},
                 {"hidden", Json::array()},
                 {"found", Json::array()},
                 {"notes", result_.found.notes}};
    for (const ScenarioEffect& effect : result_.hidden)
      json["hidden"].push_back(EffectJson(effect.joint, effect.type, effect.values));
    for (const FoundEffect& effect : result_.found.effects)
      json["found"].push_back(EffectJson(effect));
    json["replay"] = {{"episodes", result_.replayed_episodes},
                      {"before", ReplayJson(result_.replay_before)},
                      {"after", ReplayJson(result_.replay_after)}};
    const auto rate = [](const SuccessRate& r) {
      const Interval wilson = WilsonInterval(r.successes, r.episodes);
      return Json{{"successes", r.successes},
                  {"episodes", r.episodes},
                  {"wilson", {wilson.low, wilson.high}}};
    };
    const auto agreement = [](const Agreement& a) {
      return Json{{"same", a.same}, {"episodes", a.episodes}};
    };
    json["success"] = {
        {"policy", options_.policy},
        {"clean", rate(result_.clean)},
        {"hidden", rate(result_.under_hidden)},
        {"found", rate(result_.under_found)},
        {"same_as_hidden",
         {{"clean", agreement(result_.clean_agrees)}, {"found", agreement(result_.found_agrees)}}}};
    return json;
  }

  const CloseLoopOptions& options_;
  CloseLoopResult result_;
  RecordedRun recorded_;
  std::set<std::string> unseen_;  // episodes that were not fitted
};

}  // namespace

absl::StatusOr<CloseLoopResult> CloseLoop(const CloseLoopOptions& options) {
  RS_RETURN_IF_ERROR(MakeDirectories(options.out));
  return Circle(options).Run();
}

std::string CloseLoopTable(const CloseLoopResult& r) {
  std::string text = absl::StrFormat(
      "recorded %d episodes, %.1f s of free motion (%.1f s near contacts left out); verdict %s\n",
      r.rig.episodes, r.rig.seconds, r.rig.seconds_left_out, r.found.verdict);
  for (const ScenarioEffect& effect : r.hidden)
    absl::StrAppendFormat(&text, "  hidden  %s  %-28s %s\n", JointName(effect.joint), effect.type,
                          EffectValues(effect.type, effect.values));
  for (const FoundEffect& effect : r.found.effects) absl::StrAppend(&text, EffectLine(effect));
  for (const std::string& note : r.found.notes) absl::StrAppend(&text, "  note    ", note, "\n");
  absl::StrAppendFormat(&text,
                        "\nrecorded actions played again, %d unseen episodes, rms      before      "
                        "after\n",
                        r.replayed_episodes);
  const auto line = [&](const char* what, double before, double after, const char* unit) {
    absl::StrAppendFormat(&text, "  %-52s %10.4f %10.4f %s\n", what, before, after, unit);
  };
  const ReplayComparison &b = r.replay_before, &a = r.replay_after;
  line("joints, until first contact", 1e3 * b.free_motion.joint_rad, 1e3 * a.free_motion.joint_rad,
       "mrad");
  line("tool, until first contact", 1e3 * b.free_motion.tool_m, 1e3 * a.free_motion.tool_m, "mm");
  line("joints, whole episodes", 1e3 * b.whole.joint_rad, 1e3 * a.whole.joint_rad, "mrad");
  line("tool, whole episodes", 1e3 * b.whole.tool_m, 1e3 * a.whole.tool_m, "mm");
  absl::StrAppend(
      &text, "\nsuccess                      95 %, Wilson       outcome as under the hidden\n");
  const auto success = [&](const char* scenario, const SuccessRate& s, const std::string& same) {
    const Interval wilson = WilsonInterval(s.successes, s.episodes);
    absl::StrAppendFormat(&text, "  %-16s %3d of %-3d %5.1f to %5.1f %%    %s\n", scenario,
                          s.successes, s.episodes, 100 * wilson.low, 100 * wilson.high, same);
  };
  const auto same = [](const Agreement& a) {
    return absl::StrFormat("%d of %d", a.same, a.episodes);
  };
  success("Clean", r.clean, same(r.clean_agrees));
  success("hidden scenario", r.under_hidden, "");
  success("found scenario", r.under_found, same(r.found_agrees));
  return text;
}

}  // namespace robostress
