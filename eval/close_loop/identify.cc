#include "eval/close_loop/identify.h"

#include <chrono>
#include <cstdio>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "eval/close_loop/recorded_run.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr char kCommand[] = "identify";
constexpr int kDevSplit = 40;  // first initial state

absl::StatusOr<IdentifiedArm> IdentifyOne(const IdentifyOptions& options,
                                          const std::string& scenario) {
  IdentifiedArm arm;
  arm.scenario = ScenarioLabel(scenario);
  const auto place = [&](const char* name) {
    return (fs::path(options.out) / arm.scenario / name).string();
  };
  arm.file = (fs::path(options.out) / (arm.scenario + "_found.yaml")).string();
  std::fprintf(stderr, "%s: %s\n", kCommand, arm.scenario.c_str());
  RS_RETURN_IF_ERROR(MakeDirectories(place("")));
  RS_RETURN_IF_ERROR(
      KeepCircleOptions(place("options.json"),
                        {{"scenario", IsScenarioFile(scenario) ? HiddenPlace(scenario) : scenario},
                         {"policy", options.policy},
                         {"suite", options.suite},
                         {"tasks", options.tasks},
                         {"episodes", options.episodes},
                         {"severity", options.severity},
                         {"rate_hz", options.rate_hz},
                         {"surrogates", options.surrogates},
                         {"seed", options.seed}}));
  SweepGrid grid;
  grid.suites = {options.suite};
  grid.tasks = options.tasks;
  grid.methods = {"base"};
  grid.severities = {options.severity};
  grid.scenarios = {scenario};
  grid.policies = {options.policy};
  grid.episodes = options.episodes;
  grid.first_initial_state = kDevSplit;
  RS_RETURN_IF_ERROR(
      RunWholeGrid(kCommand, std::move(grid), place("recording"), options.workers, true).status());
  RS_ASSIGN_OR_RETURN(
      const RecordedRun recorded,
      MakeRecordedRig(place("recording"), options.rate_hz, options.seed, place("rig")));
  arm.rig = recorded.rig;
  const auto start = std::chrono::steady_clock::now();
  const std::string rig_file = place("rig/rig.yaml");
  RS_RETURN_IF_ERROR(RunCalibration(kCommand, rig_file, place("calibration"),
                                    place("calibration.log"), options.surrogates, options.seed));
  arm.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  RS_ASSIGN_OR_RETURN(arm.found,
                      ReadFoundEffects(rig_file, place("calibration"), arm.file, kPanda));
  if (arm.found.effects.empty()) {
    ScenarioFile nothing;
    nothing.title = "Nothing found";
    RS_RETURN_IF_ERROR(WriteFileAtomically(arm.file, WriteScenarioFile(nothing, kPanda)));
  }
  return arm;
}

}  // namespace

absl::StatusOr<std::vector<IdentifiedArm>> Identify(const IdentifyOptions& options) {
  std::vector<IdentifiedArm> arms;
  for (const std::string& scenario : options.scenarios) {
    RS_ASSIGN_OR_RETURN(arms.emplace_back(), IdentifyOne(options, scenario));
  }
  return arms;
}

std::string IdentifiedTable(const std::vector<IdentifiedArm>& arms) {
  std::string text;
  for (const IdentifiedArm& arm : arms) {
    absl::StrAppendFormat(
        &text, "%s  %d episodes, %.1f s of free motion, calibrated in %.0f s: %s\n", arm.file,
        arm.rig.episodes, arm.rig.seconds, arm.seconds, arm.found.verdict);
    for (const FoundEffect& effect : arm.found.effects) absl::StrAppend(&text, EffectLine(effect));
    for (const std::string& note : arm.found.notes)
      absl::StrAppend(&text, "  note    ", note, "\n");
  }
  return text;
}

}  // namespace robostress
