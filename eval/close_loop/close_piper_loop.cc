#include "eval/close_loop/close_piper_loop.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/data/client_recordings.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using calibration::RecordedEpisode;
using Json = nlohmann::ordered_json;

// An arm of "new" without its effects: the rig's model and the servo, nothing else.
constexpr char kWithout[] = "joints: []\n";

class PiperCircle {
 public:
  explicit PiperCircle(const ClosePiperLoopOptions& options) : options_(options) {}

  absl::StatusOr<ClosePiperLoopResult> Run() {
    RS_ASSIGN_OR_RETURN(const ScenarioFile hidden, ReadHidden(options_.hidden, kPiper));
    result_.hidden = hidden.effects;
    RS_RETURN_IF_ERROR(KeepOptions());
    RS_RETURN_IF_ERROR(WriteFileAtomically(Out("without.yaml"), kWithout));
    const bool clean = options_.hidden == kNothingHidden;
    RS_RETURN_IF_ERROR(Play(clean ? Out("without.yaml") : options_.hidden, "recording"));
    RS_RETURN_IF_ERROR(Find());
    RS_RETURN_IF_ERROR(Play(Out("without.yaml"), "without"));
    RS_ASSIGN_OR_RETURN(result_.before_rad, Apart("without"));
    if (result_.found.effects.empty()) {
      result_.after_rad = result_.before_rad;
    } else {
      RS_RETURN_IF_ERROR(Play(Out("found.yaml"), "with"));
      RS_ASSIGN_OR_RETURN(result_.after_rad, Apart("with"));
    }
    RS_RETURN_IF_ERROR(WriteFileAtomically(Out("summary.json"), Summary().dump(2) + "\n"));
    return result_;
  }

 private:
  std::string Out(const std::string& name) const {
    return (fs::path(options_.out) / name).string();
  }

  absl::Status KeepOptions() const {
    const Json json = {{"arm", "piper"},
                       {"hidden", HiddenPlace(options_.hidden)},
                       {"episodes", options_.episodes},
                       {"surrogates", options_.surrogates},
                       {"seed", options_.seed}};
    return KeepCircleOptions(Out("options.json"), json);
  }

  // Reaches of an emulated arm in simulated time, recorded as a client records.
  absl::Status Play(const std::string& profile, const std::string& folder) const {
    if (fs::exists(Out(folder + "/samples.csv"))) return absl::OkStatus();
    std::error_code ignored;
    fs::remove_all(Out(folder), ignored);  // one that was cut off
    const std::string program = (fs::path(ProgramFolder()) / "piper_residual").string();
    const std::string log = Out(folder + ".log");
    std::fprintf(stderr, "close-loop: %d episodes of a Piper into %s\n", options_.episodes,
                 Out(folder).c_str());
    RS_ASSIGN_OR_RETURN(
        ChildProcess child,
        ChildProcess::Start({program, "--profile", profile, "--episodes",
                             absl::StrCat(options_.episodes), "--record", Out(folder)},
                            {}, log));
    const ExitState exit = child.WaitForEnd();
    if (exit.code == 0) return absl::OkStatus();
    return absl::InternalError(
        absl::StrCat("piper_residual ended with ", exit.text, ":\n", LastLines(log, 15)));
  }

  absl::Status Find() {
    RS_ASSIGN_OR_RETURN(recording_, Episodes("recording"));
    calibration::RecordedRigOptions rig;
    rig.encoder_noise = 0;
    RS_ASSIGN_OR_RETURN(result_.rig,
                        calibration::WriteRecordedRig(calibration::PiperOfRecordings("piper", 0),
                                                      recording_, rig, Out("rig")));
    RS_RETURN_IF_ERROR(RunCalibration("close-loop", Out("rig/rig.yaml"), Out("calibration"),
                                      Out("calibration.log"), options_.surrogates, options_.seed));
    RS_ASSIGN_OR_RETURN(result_.found, ReadFoundEffects(Out("rig/rig.yaml"), Out("calibration"),
                                                        Out("found.yaml"), kPiper));
    return absl::OkStatus();
  }

  absl::StatusOr<std::vector<RecordedEpisode>> Episodes(const std::string& folder) const {
    return calibration::EpisodesOfClientRun(Out(folder),
                                            calibration::RecordedRigOptions().held_out_every);
  }

  // Of the episodes that were not fitted.
  absl::StatusOr<double> Apart(const std::string& folder) {
    RS_ASSIGN_OR_RETURN(const std::vector<RecordedEpisode> played, Episodes(folder));
    if (played.size() != recording_.size())
      return absl::DataLossError(absl::StrCat(Out(folder), ": has ", played.size(),
                                              " episodes, the recording ", recording_.size()));
    const int every = calibration::RecordedRigOptions().held_out_every;
    double sum = 0, count = 0;
    result_.unseen_episodes = 0;
    for (size_t e = every - 1; e < played.size(); e += every, ++result_.unseen_episodes) {
      for (size_t j = 0; j < played[e].q.size(); ++j) {
        const size_t rows = std::min(played[e].q[j].size(), recording_[e].q[j].size());
        for (size_t i = 0; i < rows; ++i, ++count)
          sum += std::pow(played[e].q[j][i] - recording_[e].q[j][i], 2);
      }
    }
    return count > 0 ? std::sqrt(sum / count) : 0.0;
  }

  Json Summary() const {
    Json json = {{"arm", "piper"},
                 {"verdict", result_.found.verdict},
                 {"recorded_episodes", result_.rig.episodes},
                 {"free_motion_s", result_.rig.seconds},
                 {"hidden", Json::array()},
                 {"found", Json::array()},
                 {"notes", result_.found.notes}};
    for (const ScenarioEffect& effect : result_.hidden)
      json["hidden"].push_back(EffectJson(effect.joint, effect.type, effect.values));
    for (const FoundEffect& effect : result_.found.effects)
      json["found"].push_back(EffectJson(effect));
    json["repeated"] = {{"episodes", result_.unseen_episodes},
                        {"before_joint_rad", result_.before_rad},
                        {"after_joint_rad", result_.after_rad}};
    return json;
  }

  const ClosePiperLoopOptions& options_;
  ClosePiperLoopResult result_;
  std::vector<RecordedEpisode> recording_;
};

}  // namespace

absl::StatusOr<ClosePiperLoopResult> ClosePiperLoop(const ClosePiperLoopOptions& options) {
  RS_RETURN_IF_ERROR(MakeDirectories(options.out));
  return PiperCircle(options).Run();
}

std::string ClosePiperLoopTable(const ClosePiperLoopResult& r) {
  std::string text = absl::StrFormat("recorded %d episodes, %.1f s of a Piper; verdict %s\n",
                                     r.rig.episodes, r.rig.seconds, r.found.verdict);
  for (const ScenarioEffect& effect : r.hidden)
    absl::StrAppendFormat(&text, "  hidden  %s  %-28s %s\n", JointName(effect.joint), effect.type,
                          EffectValues(effect.type, effect.values));
  for (const FoundEffect& effect : r.found.effects) absl::StrAppend(&text, EffectLine(effect));
  for (const std::string& note : r.found.notes) absl::StrAppend(&text, "  note    ", note, "\n");
  absl::StrAppendFormat(&text,
                        "\nthe same targets again, %d unseen episodes, rms of the joints from the "
                        "recorded ones\n  without what was found %.4f mrad, with it %.4f mrad\n",
                        r.unseen_episodes, 1e3 * r.before_rad, 1e3 * r.after_rad);
  return text;
}

}  // namespace robostress
