#include "eval/export/export_run.h"

#include <algorithm>
#include <filesystem>
#include <map>
#include <optional>
#include <tuple>
#include <utility>

#include "absl/algorithm/container.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "common/joint_errors/scenario_file.h"
#include "common/lerobot/lerobot_dataset.h"
#include "common/libero/demonstrations.h"
#include "common/records/episode_recording.h"
#include "common/status_macros.h"
#include "eval/export/arm_run_mcap.h"
#include "eval/export/episode_mcap.h"
#include "eval/plan/plan.h"
#include "eval/store/run_store.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using Step = EpisodeRecording::Step;

// As LeRobot's LIBERO names them.
const std::map<std::string, std::string>& CameraNames() {
  static const auto& names = *new std::map<std::string, std::string>{
      {"agentview", "image"}, {"robot0_eye_in_hand", "image2"}};
  return names;
}

std::vector<std::string> Numbered(const char* stem, int count) {
  std::vector<std::string> names;
  for (int i = 1; i <= count; ++i) names.push_back(absl::StrCat(stem, i));
  return names;
}

LerobotSchema SchemaOf(const EpisodeRecording& recording) {
  const std::vector<std::string> action = {"x", "y", "z", "rx", "ry", "rz", "gripper"};
  LerobotSchema schema{"panda", recording.rate_hz, {}, {}};
  schema.vectors = {{"observation.state", {"x", "y", "z", "rx", "ry", "rz", "finger1", "finger2"}},
                    {"observation.joints", Numbered("J", 7)},
                    {"observation.joint_velocities", Numbered("J", 7)},
                    {"action", action},
                    {"action.sent", action},
                    {"action.measured", action}};
  for (const std::string& camera : recording.cameras) {
    const auto known = CameraNames().find(camera);
    schema.cameras.push_back(known == CameraNames().end() ? camera : known->second);
  }
  return schema;
}

template <class Row>
std::vector<float> Column(const EpisodeRecording& recording, const Row& row) {
  std::vector<float> column;
  for (const Step& step : recording.steps)
    for (const auto v : row(step)) column.push_back(static_cast<float>(v));
  return column;
}

// [camera][step]
absl::StatusOr<std::vector<std::vector<Image>>> Decoded(const EpisodeRecording& recording) {
  std::vector<std::vector<Image>> images;
  for (const std::vector<std::string>& pictures : recording.pictures) {
    std::vector<Image>& views = images.emplace_back();
    for (const std::string& png : pictures) {
      RS_ASSIGN_OR_RETURN(Image image, DecodePng(png));
      views.push_back(std::move(image));
    }
  }
  return images;
}

absl::Status AppendTo(LerobotDataset& dataset, EpisodeRecording recording,
                      std::vector<std::vector<Image>> images) {
  LerobotEpisode episode;
  episode.instruction = recording.instruction;
  episode.success = recording.success;
  episode.steps = recording.steps.size();
  episode.vectors = {Column(recording, [](const Step& s) { return s.proprioception; }),
                     Column(recording, [](const Step& s) { return s.before.q; }),
                     Column(recording, [](const Step& s) { return s.before.dq; }),
                     Column(recording, [](const Step& s) { return s.commanded; }),
                     Column(recording, [](const Step& s) { return s.sent; }),
                     Column(recording, [](const Step& s) { return s.measured; })};
  episode.pictures = std::move(recording.pictures);
  for (const std::vector<Image>& views : images) {
    episode.width.push_back(views[0].width);
    episode.height.push_back(views[0].height);
  }
  episode.small = std::move(images);
  return dataset.Append(episode);
}

LiberoDemonstration ToLibero(const EpisodeRecording& recording,
                             std::vector<std::vector<Image>> images) {
  LiberoDemonstration demonstration;
  // What LIBERO's suites show a policy is what LIBERO stores, mirrored.
  const bool libero = !recording.problem.empty();
  demonstration.model_file = recording.model_file;
  demonstration.initial_state = recording.initial_state;
  demonstration.success = recording.success;
  LiberoColumns& columns = demonstration.columns;
  columns.steps = static_cast<int64_t>(recording.steps.size());
  const auto append = [](std::vector<double>& column, const Eigen::VectorXf& values) {
    column.insert(column.end(), values.begin(), values.end());
  };
  for (const Step& step : recording.steps) {
    append(columns.actions, step.commanded);
    append(columns.sent, step.sent);
    append(columns.measured, step.measured);
    if (!libero) append(columns.proprioception, step.proprioception);
    columns.Add(step.simulator);
  }
  for (std::vector<Image>& views : images)
    for (Image& view : views)
      if (libero) view = MirrorColumns(view);
  demonstration.agentview = std::move(images[0]);
  demonstration.eye_in_hand = std::move(images[1]);
  return demonstration;
}

// Which unit and which episode of it this is.
nlohmann::ordered_json OriginOf(const std::string& unit, const EpisodeRecording& recording) {
  return {{"unit", unit},
          {"scenario", recording.scenario},
          {"severity", recording.severity},
          {"method", recording.method},
          {"policy", recording.policy},
          {"seed", recording.seed},
          {"suite", recording.suite},
          {"task", recording.task},
          {"initial_state", recording.initial_state},
          {"success", recording.success}};
}

// What is written, and taken away again where it does not end well.
class Targets {
 public:
  static absl::StatusOr<std::unique_ptr<Targets>> Make(const ExportOptions& options) {
    for (const std::string& folder : Folders(options)) {
      if (fs::exists(folder) && !fs::is_empty(folder)) {
        return absl::InvalidArgumentError(
            absl::StrCat(folder, " holds something already; name a new folder"));
      }
    }
    return std::unique_ptr<Targets>(new Targets(options));
  }
  ~Targets() {
    std::error_code ignored;
    if (done_) return;
    libero_.clear();
    for (const std::string& folder : Folders(options_)) fs::remove_all(folder, ignored);
  }

  absl::Status Add(const std::string& unit, EpisodeRecording recording) {
    if (!options_.mcap.empty()) RS_RETURN_IF_ERROR(AddMcap(unit, recording));
    if (options_.libero.empty() && options_.lerobot.empty()) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(std::vector<std::vector<Image>> images, Decoded(recording));
    if (!options_.libero.empty()) RS_RETURN_IF_ERROR(AddLibero(unit, recording, images));
    if (options_.lerobot.empty()) return absl::OkStatus();
    if (!lerobot_.has_value()) {
      RS_ASSIGN_OR_RETURN(lerobot_, LerobotDataset::Open(options_.lerobot, SchemaOf(recording)));
    }
    nlohmann::ordered_json origin = {{"episode_index", lerobot_->episodes()}};
    origin.update(OriginOf(unit, recording));
    absl::StrAppend(&origins_, origin.dump(), "\n");
    return AppendTo(*lerobot_, std::move(recording), std::move(images));
  }

  absl::Status Publish(ExportSummary& summary) {
    for (auto& [path, writer] : libero_) {
      RS_RETURN_IF_ERROR(writer.Publish());
      summary.written.push_back(path);
    }
    if (lerobot_.has_value()) {
      RS_RETURN_IF_ERROR(
          WriteFileAtomically(options_.lerobot + "/meta/robostress_episodes.jsonl", origins_));
      summary.written.push_back(options_.lerobot);
    }
    if (!options_.mcap.empty()) summary.written.push_back(options_.mcap);
    done_ = true;
    return absl::OkStatus();
  }

 private:
  explicit Targets(const ExportOptions& options) : options_(options) {}

  static std::vector<std::string> Folders(const ExportOptions& options) {
    std::vector<std::string> folders = {options.lerobot, options.libero, options.mcap};
    folders.erase(std::remove(folders.begin(), folders.end(), ""), folders.end());
    return folders;
  }

  absl::Status AddMcap(const std::string& unit, const EpisodeRecording& recording) {
    RS_RETURN_IF_ERROR(MakeDirectories(options_.mcap));
    std::map<std::string, std::string> origin = {{"task_name", recording.task_name},
                                                 {"instruction", recording.instruction},
                                                 {"episode", absl::StrCat(recording.episode)},
                                                 {"rate_hz", absl::StrCat(recording.rate_hz)}};
    const nlohmann::ordered_json known = OriginOf(unit, recording);
    for (const auto& [key, value] : known.items())
      origin[key] = value.is_string() ? value.get<std::string>() : value.dump();
    return WriteEpisodeMcap(recording, origin,
                            absl::StrFormat("%s/%s-task%d-episode%d.mcap", options_.mcap, unit,
                                            recording.task, recording.episode));
  }

  absl::Status AddLibero(const std::string& unit, const EpisodeRecording& recording,
                         const std::vector<std::vector<Image>>& images) {
    if (recording.cameras != std::vector<std::string>{"agentview", "robot0_eye_in_hand"}) {
      return absl::InvalidArgumentError(
          absl::StrCat("LIBERO's form has the views agentview and robot0_eye_in_hand, this "
                       "recording ",
                       absl::StrJoin(recording.cameras, ", "), "; leave --libero out"));
    }
    RS_RETURN_IF_ERROR(MakeDirectories(options_.libero));
    const std::string path = absl::StrCat(options_.libero, "/", recording.task_name, "_demo.hdf5");
    const std::string& other = suites_.try_emplace(path, recording.suite).first->second;
    if (other != recording.suite) {
      return absl::InvalidArgumentError(absl::StrCat(
          "suites ", other, " and ", recording.suite, " both have a task ", recording.task_name,
          ", and LIBERO's form has one file a task; sweep them into two runs, or leave --libero "
          "out"));
    }
    auto at = libero_.find(path);
    if (at == libero_.end()) {
      RS_ASSIGN_OR_RETURN(LiberoDemonstrationWriter writer,
                          LiberoDemonstrationWriter::Create(
                              path, {.suite = recording.suite,
                                     .task = recording.task_name,
                                     .instruction = recording.instruction,
                                     .control_hz = static_cast<int>(recording.rate_hz),
                                     .problem = recording.problem}));
      at = libero_.emplace(path, std::move(writer)).first;
    }
    LiberoDemonstration demonstration = ToLibero(recording, images);
    demonstration.origin = OriginOf(unit, recording).dump();
    return at->second.Add(demonstration);
  }

  const ExportOptions& options_;
  std::optional<LerobotDataset> lerobot_;
  std::map<std::string, LiberoDemonstrationWriter> libero_;  // by path
  std::map<std::string, std::string> suites_;                // of these files
  std::string origins_;
  bool done_ = false;
};

bool Wanted(const std::vector<std::string>& names, const std::string& name) {
  return names.empty() || absl::c_linear_search(names, name);
}

// Of the names that were asked for, those that the run has not.
absl::Status CheckNames(const char* flag, std::vector<std::string> asked,
                        const std::vector<std::string>& there) {
  for (const std::string& name : asked) {
    if (absl::c_linear_search(there, name)) continue;
    std::vector<std::string> known = there;
    absl::c_sort(known);
    known.erase(std::unique(known.begin(), known.end()), known.end());
    return absl::InvalidArgumentError(
        absl::StrCat(flag, " ", name, ": the run has none; it has ", absl::StrJoin(known, ", ")));
  }
  return absl::OkStatus();
}

// The recording of a row, and no other's.
absl::StatusOr<EpisodeRecording> ReadRecording(const std::string& file, const UnitConfig& unit,
                                               const EpisodeRow& row) {
  if (!fs::exists(file)) {
    return absl::NotFoundError(absl::StrCat(
        "no recording ", file,
        "; play the run anew into another folder with `robostress sweep "
        "--record-episodes 128`, or leave the unit out with --methods or --scenarios"));
  }
  absl::StatusOr<EpisodeRecording> read = ReadEpisodeRecording(file);
  if (!read.ok()) return absl::DataLossError(read.status().message());
  const auto of_row = std::make_tuple(
      unit.suite, ScenarioLabel(unit.scenario), PolicyLabel(unit.policy), unit.method->method,
      unit.seed, row.task, row.episode, static_cast<size_t>(row.steps), row.success);
  const auto of_file =
      std::make_tuple(read->suite, read->scenario, PolicyLabel(read->policy), read->method,
                      read->seed, read->task, read->episode, read->steps.size(), read->success);
  if (of_row != of_file) {
    return absl::DataLossError(
        absl::StrCat(file, ": is not of the episode in episodes.jsonl, but of ", read->suite,
                     " task ", read->task, " episode ", read->episode, ", ", read->scenario, ", ",
                     read->method, ", seed ", read->seed, ", ", read->steps.size(), " steps"));
  }
  return read;
}

absl::StatusOr<ExportSummary> ExportArmRun(const ExportOptions& options) {
  if (!options.lerobot.empty() || !options.libero.empty() || !options.methods.empty() ||
      !options.scenarios.empty() || options.successes_only) {
    return absl::InvalidArgumentError(absl::StrCat(
        options.run,
        ": is a run of robot_client, which is written whole and with --mcap FOLDER alone; what it "
        "demonstrated is a data set already, its folder lerobot/"));
  }
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Targets> targets, Targets::Make(options));
  RS_RETURN_IF_ERROR(MakeDirectories(options.mcap));
  const std::string name = fs::absolute(options.run).lexically_normal().filename().string();
  RS_ASSIGN_OR_RETURN(
      const ArmRunSummary written,
      WriteArmRunMcap(options.run,
                      absl::StrCat(options.mcap, "/", name.empty() ? "run" : name, ".mcap")));
  ExportSummary summary;
  summary.ticks = written.ticks;
  summary.samples = written.samples;
  summary.pictures = written.pictures;
  summary.pictures_missing = written.pictures_missing;
  RS_RETURN_IF_ERROR(targets->Publish(summary));
  return summary;
}

}  // namespace

absl::StatusOr<ExportSummary> ExportRun(const ExportOptions& options) {
  if (options.lerobot.empty() && options.libero.empty() && options.mcap.empty()) {
    return absl::InvalidArgumentError(
        "nothing to write; give --lerobot FOLDER, --libero FOLDER or --mcap FOLDER, or several");
  }
  if (IsArmRun(options.run)) return ExportArmRun(options);
  RS_ASSIGN_OR_RETURN(const RunData run, LoadRun(options.run));
  std::vector<std::string> methods, scenarios;
  for (const UnitResult& unit : run.units) {
    methods.push_back(unit.config.method->method);
    scenarios.push_back(ScenarioLabel(unit.config.scenario));
  }
  RS_RETURN_IF_ERROR(CheckNames("--methods", options.methods, methods));
  RS_RETURN_IF_ERROR(CheckNames("--scenarios", options.scenarios, scenarios));
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<Targets> targets, Targets::Make(options));
  ExportSummary summary;
  summary.unfinished = static_cast<int64_t>(run.unfinished.size());
  for (const UnitResult& unit : run.units) {
    if (!Wanted(options.methods, unit.config.method->method) ||
        !Wanted(options.scenarios, ScenarioLabel(unit.config.scenario)))
      continue;
    for (const EpisodeRow& row : unit.episodes) {
      if (row.steps == 0) continue;
      if (options.successes_only && !row.success) {
        ++summary.failures_left_out;
        continue;
      }
      const std::string file = absl::StrFormat("%s/units/%s/episodes/task%d_episode%d.safetensors",
                                               options.run, unit.id, row.task, row.episode);
      RS_ASSIGN_OR_RETURN(EpisodeRecording recording, ReadRecording(file, unit.config, row));
      ++summary.episodes;
      summary.steps += static_cast<int64_t>(recording.steps.size());
      RS_RETURN_IF_ERROR(targets->Add(unit.id, std::move(recording)));
    }
  }
  if (summary.episodes == 0) {
    return absl::NotFoundError(absl::StrCat(
        options.run, ": no episode is left to write",
        summary.failures_left_out > 0
            ? absl::StrCat("; ", summary.failures_left_out, " failed, leave --successes out")
            : ""));
  }
  RS_RETURN_IF_ERROR(targets->Publish(summary));
  return summary;
}

}  // namespace robostress
