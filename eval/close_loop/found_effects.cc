#include "eval/close_loop/found_effects.h"

#include <cstdio>
#include <filesystem>
#include <map>

#include "absl/algorithm/container.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/model/scenario_output.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/json_text.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;

// Verdict and rivals of `effect` from the report of its joint, whose name ends in joint<number>.
// Throws json::exception where a field has another type.
void TakeVerdict(const nlohmann::json& report, FoundEffect& effect) {
  for (const auto& joint : report.value("joints", nlohmann::json::array())) {
    if (!absl::EndsWith(joint.value("joint", ""), absl::StrCat("joint", effect.joint + 1)))
      continue;
    effect.verdict = joint.value("verdict", "");
    for (const auto& added : joint.value("effects_added", nlohmann::json::array())) {
      if (added.value("type", "") != effect.type) continue;
      // Effects between two joints are told once for every partner.
      for (const auto& rival : added.value("ambiguous_with", nlohmann::json::array())) {
        const auto type = rival.get<std::string>();
        if (!absl::c_linear_search(effect.ambiguous_with, type))
          effect.ambiguous_with.push_back(type);
      }
    }
  }
}

}  // namespace

absl::StatusOr<ScenarioFile> ReadHidden(const std::string& hidden, const RobotDescription& arm) {
  if (hidden == kNothingHidden) return ScenarioFile{};
  return ReadScenarioFile(hidden, arm);
}

std::string HiddenPlace(const std::string& hidden) {
  return hidden == kNothingHidden ? hidden : fs::absolute(hidden).lexically_normal().string();
}

absl::Status RunCalibration(const std::string& command, const std::string& rig_file,
                            const std::string& out, const std::string& log, int surrogates,
                            uint64_t seed, int max_effects) {
  if (fs::exists(fs::path(out) / "report.json")) return absl::OkStatus();
  RS_ASSIGN_OR_RETURN(const std::string program, FindProgram("calibrate"));
  std::fprintf(stderr, "%s: calibrating, progress in %s\n", command.c_str(), log.c_str());
  RS_ASSIGN_OR_RETURN(
      ChildProcess child,
      ChildProcess::Start(
          {program, "--rig", rig_file, "--out", out, "--surrogates", absl::StrCat(surrogates),
           "--seed", absl::StrCat(seed), "--max-effects", absl::StrCat(max_effects)},
          {{"OMP_NUM_THREADS", "1"}, {"OPENBLAS_NUM_THREADS", "1"}}, log));
  const ExitState exit = child.WaitForEnd();
  if (exit.code == 0) return absl::OkStatus();
  return absl::InternalError(
      absl::StrCat("robostress calibrate ended with ", exit.text, ":\n", LastLines(log, 15)));
}

absl::StatusOr<FoundEffects> ReadFoundEffects(const std::string& rig_file,
                                              const std::string& folder,
                                              const std::string& scenario_file,
                                              const RobotDescription& arm) {
  RS_ASSIGN_OR_RETURN(const calibration::Rig declared, calibration::ReadRig(rig_file));
  RS_ASSIGN_OR_RETURN(const calibration::Rig after,
                      calibration::ReadRig((fs::path(folder) / "rig_after.yaml").string()));
  const std::string report_file = (fs::path(folder) / "report.json").string();
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(report_file));
  const nlohmann::json report = nlohmann::json::parse(text, nullptr, false);
  if (!report.is_object())
    return absl::DataLossError(absl::StrCat(report_file, ": is no JSON object"));
  FoundEffects found;
  found.verdict = TextAt(report, "verdict");
  RS_ASSIGN_OR_RETURN(const calibration::JointMap map,
                      calibration::ParseJointMap({"own"}, declared, arm));
  const auto output = calibration::ScenarioOfRig(declared, after, map, "Found", arm);
  if (absl::IsFailedPrecondition(output.status())) {
    found.notes.push_back(std::string(output.status().message()));
    return found;
  }
  RS_RETURN_IF_ERROR(output.status());
  found.notes = output->notes;
  for (const ScenarioEffect& effect : output->scenario.effects) {
    found.effects.push_back({effect.joint, effect.type, "", effect.values, {}});
    try {
      TakeVerdict(report, found.effects.back());
    } catch (const nlohmann::json::exception& error) {
      return absl::DataLossError(absl::StrCat(report_file, ": ", error.what(), "; remove ", folder,
                                              " and run the command again"));
    }
  }
  RS_RETURN_IF_ERROR(WriteFileAtomically(scenario_file, WriteScenarioFile(output->scenario, arm)));
  return found;
}

absl::Status KeepCircleOptions(const std::string& file, const nlohmann::ordered_json& options) {
  const std::string text = options.dump(2) + "\n";
  if (!fs::exists(file)) return WriteFileAtomically(file, text);
  RS_ASSIGN_OR_RETURN(const std::string present, ReadFile(file));
  if (present == text) return absl::OkStatus();
  return absl::FailedPreconditionError(
      absl::StrCat(file, " was begun with other options; repeat them or choose another --out"));
}

std::string JointName(int joint) { return absl::StrCat("J", joint + 1); }

nlohmann::ordered_json EffectJson(int joint, const std::string& type,
                                  const std::vector<double>& values) {
  nlohmann::ordered_json json = {{"joint", JointName(joint)}, {"type", type}};
  const auto info = FindEffect(type);
  for (size_t i = 0; info.ok() && i < values.size(); ++i)
    json["parameters"][(*info)->parameters[i].name] = values[i];
  return json;
}

nlohmann::ordered_json EffectJson(const FoundEffect& effect) {
  nlohmann::ordered_json json = EffectJson(effect.joint, effect.type, effect.values);
  json["verdict"] = effect.verdict;
  json["ambiguous_with"] = effect.ambiguous_with;
  return json;
}

std::string EffectValues(const std::string& type, const std::vector<double>& values) {
  std::vector<std::string> texts;
  const auto info = FindEffect(type);
  for (size_t i = 0; info.ok() && i < values.size(); ++i) {
    const EffectParameter& parameter = (*info)->parameters[i];
    texts.push_back(absl::StrFormat("%s %.4g %s", parameter.name, values[i], parameter.unit));
  }
  return absl::StrJoin(texts, ", ");
}

std::string EffectLine(const FoundEffect& effect) {
  return absl::StrFormat(
      "  found   %s  %-28s %s  (%s%s)\n", JointName(effect.joint), effect.type,
      EffectValues(effect.type, effect.values), effect.verdict,
      effect.ambiguous_with.empty() ? "" : ", or " + absl::StrJoin(effect.ambiguous_with, ", "));
}

}  // namespace robostress
