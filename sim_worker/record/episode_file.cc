#include "sim_worker/record/episode_file.h"

#include <nlohmann/json.hpp>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/hdf5_file.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/record/libero_recorder.h"

namespace robostress {
namespace {

bool IsHdf5(const std::string& path) { return absl::EndsWith(path, ".hdf5"); }

// The settings with which a file was recorded; "" where it does not say.
std::string SettingsIn(const std::string& path) {
  if (IsHdf5(path)) {
    const absl::StatusOr<Hdf5File> file = Hdf5File::Open(path);
    return file.ok() ? file->StringAttribute("data/demo_0", "origin").value_or("") : "";
  }
  const absl::StatusOr<SafetensorsFile> file = SafetensorsFile::Open(path);
  if (!file.ok() || !file->metadata().contains("settings")) return "";
  return file->metadata().at("settings");
}

// Takes the number of episodes out of settings; 0 where they do not say (version 0.2).
int TakeEpisodes(nlohmann::ordered_json& settings) {
  if (!settings.is_object() || !settings.contains(kEpisodesAsked)) return 0;
  const nlohmann::ordered_json asked = settings[kEpisodesAsked];
  settings.erase(kEpisodesAsked);
  return asked.is_number_integer() ? asked.get<int>() : 0;
}

}  // namespace

absl::StatusOr<bool> HoldsAlready(const std::string& path, const std::string& settings) {
  const std::string before = SettingsIn(path);
  auto old = nlohmann::ordered_json::parse(before, nullptr, false),
       now = nlohmann::ordered_json::parse(settings);
  const int held = TakeEpisodes(old), asked = TakeEpisodes(now);
  if (old.is_discarded() || old != now) {
    return absl::AlreadyExistsError(absl::StrCat(
        path, " was recorded with ", before.empty() ? "settings that it does not name" : before,
        ", now it is ", settings, "; give another --out or --tag, or remove it"));
  }
  if (held > asked) {
    return absl::AlreadyExistsError(
        absl::StrCat(path, " was recorded with --episodes ", held, ", of which --episodes ", asked,
                     " would leave a part; give another --out or --tag, or remove it"));
  }
  return held == asked;
}

EpisodeFile::EpisodeFile(std::string path, const Contents& contents, const SimTask& task)
    : path_(std::move(path)),
      settings_(contents.settings),
      shard_(contents.suite, contents.task, task.instruction(), contents.settings,
             contents.execution_noise),
      libero_suite_(FindSuite(contents.suite)->needs_libero) {}

absl::StatusOr<EpisodeFile> EpisodeFile::Create(const std::string& path, const Contents& contents,
                                                const SimTask& task) {
  EpisodeFile file(path, contents, task);
  if (IsHdf5(path)) {
    RS_ASSIGN_OR_RETURN(file.libero_,
                        LiberoDemonstrationWriter::Create(path, {.suite = contents.suite,
                                                                 .task = task.name(),
                                                                 .instruction = task.instruction(),
                                                                 .problem = task.problem()}));
  }
  return file;
}

absl::Status EpisodeFile::Add(const SimTask& task, int draw, const Demonstration& episode) {
  frames_ += static_cast<int>(episode.frames.size());
  if (libero_.has_value()) {
    LiberoDemonstration demonstration = ToLibero(episode, task.mjcf(), libero_suite_);
    demonstration.initial_state = draw;
    demonstration.origin = settings_;
    return libero_->Add(demonstration);
  }
  shard_.Add(draw, episode);
  return absl::OkStatus();
}

absl::Status EpisodeFile::Publish() {
  return libero_.has_value() ? libero_->Publish() : shard_.Write(path_);
}

}  // namespace robostress
