#pragma once

#include <optional>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/libero/demonstrations.h"
#include "sim_worker/record/expert_demonstration.h"
#include "sim_worker/record/shard.h"
#include "sim_worker/sim_task.h"

namespace robostress {

// In a recording's settings: how many episodes the file was to hold. The others say what an
// episode is a function of beside its suite, task and draw.
inline constexpr char kEpisodesAsked[] = "episodes";

// Whether the file at `path` is what would be recorded with `settings` (JSON); false: it has fewer
// episodes. AlreadyExists where it is something else, or more of it, which would be lost.
absl::StatusOr<bool> HoldsAlready(const std::string& path, const std::string& settings);

// Where a task's episodes go: a file in LIBERO's form where `path` ends in .hdf5, else a shard.
class EpisodeFile {
 public:
  struct Contents {
    std::string suite;
    int task = 0;
    std::string settings;
    double execution_noise = 0;  // as RecordOptions
  };
  static absl::StatusOr<EpisodeFile> Create(const std::string& path, const Contents& contents,
                                            const SimTask& task);
  // Of the task's last reset.
  absl::Status Add(const SimTask& task, int draw, const Demonstration& episode);
  absl::Status Publish();

  const std::string& path() const { return path_; }
  // What is written until Publish; empty where nothing is.
  std::string temporary() const { return libero_.has_value() ? libero_->temporary() : ""; }
  int frames() const { return frames_; }

 private:
  EpisodeFile(std::string path, const Contents& contents, const SimTask& task);

  std::string path_, settings_;
  Shard shard_;
  bool libero_suite_;
  std::optional<LiberoDemonstrationWriter> libero_;
  int frames_ = 0;
};

}  // namespace robostress
