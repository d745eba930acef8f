#include "eval/close_loop.h"

#include <cstdio>
#include <filesystem>
#include <map>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/sim_recordings.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "eval/merged_sweep.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using calibration::ReplayComparison;
using calibration::ReplayError;
using Json = nlohmann::ordered_json;

constexpr char kCommand[] = "close-loop";
constexpr int kDevSplit = 40;  // first initial state

class Circle {
 public:
  explicit Circle(const CloseLoopOptions& options) : options_(options) {}

  absl::StatusOr<CloseLoopResult> Run() {
    RS_ASSIGN_OR_RETURN(const ScenarioFile hidden, ReadScenarioFile(options_.hidden));
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
  absl::StatusOr<MergedSweep> RunTasks(const std::string& folder, SweepGrid grid,
                                       bool record_joints) const {
    grid.suites = {options_.suite};
    grid.tasks = options_.tasks;
    grid.methods = {"base"};
    grid.severities = {options_.severity};
    RS_ASSIGN_OR_RETURN(grid, ResolveGrid(std::move(grid)));
    RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
    LaunchOptions launch;
    launch.run_dir = Out(folder);
    launch.workers = options_.workers;
    launch.record_joints = record_joints;
    AnnouncePlan(kCommand, units, launch);
    absl::StatusOr<MergedSweep> merged = RunAndMerge(kCommand, grid, units, launch);
    if (merged.ok() && (!merged->outcome.failed.empty() || merged->outcome.signal != 0))
      return absl::InternalError(
          absl::StrCat(launch.run_dir, ": not all units are done; the same command goes on"));
    return merged;
  }

  absl::Status KeepOptions() const {
    const Json json = {{"hidden", fs::absolute(options_.hidden).lexically_normal().string()},
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
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> files,
                        calibration::FindJointLogs(Out("recording"), ""));
    std::vector<calibration::RecordedEpisode> episodes;
    for (const std::string& file : files) {
      RS_ASSIGN_OR_RETURN(JointLog log, ReadJointLog(file));
      RS_ASSIGN_OR_RETURN(calibration::RecordedEpisode episode,
                          calibration::EpisodeOfJointLog(log, options_.rate_hz));
      logs_.emplace(episode.name, std::move(log));
      episodes.push_back(std::move(episode));
    }
    calibration::RecordedRigOptions rig;
    rig.seed = options_.seed;
    contact_limit_N_ = rig.contact_limit_N;
    RS_ASSIGN_OR_RETURN(result_.rig,
                        calibration::WriteRecordedRig(calibration::PandaOfRecordings("panda"),
                                                      episodes, rig, Out("rig")));
    return absl::OkStatus();
  }

  absl::Status Calibrate() {
    RS_RETURN_IF_ERROR(RunCalibration(Out("rig/rig.yaml"), Out("calibration"),
                                      Out("calibration.log"), options_.surrogates, options_.seed));
    RS_ASSIGN_OR_RETURN(result_.found, ReadFoundEffects(Out("rig/rig.yaml"), Out("calibration"),
                                                        Out("found.yaml")));
    RS_ASSIGN_OR_RETURN(const calibration::Rig declared, calibration::ReadRig(Out("rig/rig.yaml")));
    for (const calibration::RigLog& log : declared.logs) {
      if (log.role != calibration::LogRole::kFit) unseen_.insert(log.condition);
    }
    return absl::OkStatus();
  }

  std::string Found() const { return result_.found.effects.empty() ? "clean" : Out("found.yaml"); }

  absl::Status Replay() {
    std::vector<JointLog> unseen;
    for (const auto& [name, log] : logs_) {
      if (unseen_.count(name) > 0) unseen.push_back(log);
    }
    result_.replayed_episodes = static_cast<int>(unseen.size());
    RS_ASSIGN_OR_RETURN(result_.replay_before,
                        calibration::CompareReplays(unseen, "clean", contact_limit_N_));
    RS_ASSIGN_OR_RETURN(result_.replay_after,
                        calibration::CompareReplays(unseen, Found(), contact_limit_N_));
    return absl::OkStatus();
  }

  absl::Status Evaluate() {
    SweepGrid grid;
    grid.scenarios = {"clean", options_.hidden};
    if (!result_.found.effects.empty()) grid.scenarios.push_back(Found());
    grid.policies = {options_.policy};
    grid.episodes = options_.evaluated_episodes;
    RS_ASSIGN_OR_RETURN(const MergedSweep merged, RunTasks("evaluation", grid, false));
    for (const UnitResult& unit : merged.run->units) {
      const std::string label = ScenarioLabel(unit.config.scenario);
      SuccessRate& rate = label == "clean"                          ? result_.clean
                          : label == ScenarioLabel(options_.hidden) ? result_.under_hidden
                                                                    : result_.under_found;
      for (const EpisodeRow& row : unit.episodes) {
        rate.successes += row.success;
        ++rate.episodes;
      }
    }
    if (result_.found.effects.empty()) result_.under_found = result_.clean;
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
      return Json{{"successes", r.successes}, {"episodes", r.episodes}};
    };
    json["success"] = {{"policy", options_.policy},
                       {"clean", rate(result_.clean)},
                       {"hidden", rate(result_.under_hidden)},
                       {"found", rate(result_.under_found)}};
    return json;
  }

  const CloseLoopOptions& options_;
  CloseLoopResult result_;
  std::map<std::string, JointLog> logs_;  // by episode
  std::set<std::string> unseen_;          // episodes that were not fitted
  double contact_limit_N_ = 0;
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
  const auto rate = [](const SuccessRate& s) {
    return absl::StrFormat("%d/%d", s.successes, s.episodes);
  };
  absl::StrAppendFormat(&text, "\nsuccess: Clean %s, hidden scenario %s, found scenario %s\n",
                        rate(r.clean), rate(r.under_hidden), rate(r.under_found));
  return text;
}

}  // namespace robostress
