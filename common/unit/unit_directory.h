#pragma once

#include <map>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/unit/unit_plan.h"
#include "common/unit_config.h"

namespace robostress {

// Keys of provenance.json, of units that were played from files which a name alone does not tell: a
// scenario file, a folder of LIBERO tasks, a table of where LIBERO's fixtures stand.
inline constexpr char kScenarioSha256[] = "scenario_sha256";
inline constexpr char kLiberoTasksSha256[] = "libero_tasks_sha256";
// Whether what LIBERO's tasks read is as published: kLiberoFilesPublished, or a sentence.
inline constexpr char kLiberoFiles[] = "libero_files";
inline constexpr char kLiberoFilesPublished[] = "as published";
inline constexpr char kLiberoFixturesSha256[] = "libero_fixtures_sha256";

// The files of one unit, and what makes them resumable:
//
//   config.yaml               resolved configuration; another unit's directory is refused
//   provenance.json           policy, version of the worker, hashes of weights and files
//   servers.jsonl             who answered, where somebody else serves the policy (server_row.h)
//   episodes.jsonl            one row per finished episode, durable when written
//   timing.jsonl              wall times, apart because they never repeat
//   adapter_state.safetensors while an adapted unit runs: the session after the last episode, and
//   that episode's
//                             row; published before the row, so that a stop between the two loses
//                             nothing
//   adapter.safetensors       of a finished adapted unit
//   videos/                   task{T}_episode{E}.webp
//   joints/, episodes/        task{T}_episode{E}.safetensors, of runs that record them
//   DONE                      last; holds the SHA-256 of episodes.jsonl
//
// One process at a time: the directory is locked while the object lives.
class UnitDirectory {
 public:
  // Creates or opens. Drops a torn last row. FAILED_PRECONDITION: another configuration, or a
  // worker is at work; DATA_LOSS: rows that are not the plan's, or that changed after DONE.
  // `plan` is what the directory is to hold: the unit's episodes, or a range of them.
  static absl::StatusOr<std::unique_ptr<UnitDirectory>> Open(
      const std::string& path, const UnitConfig& resolved, const std::vector<PlannedEpisode>& plan);
  ~UnitDirectory();
  UnitDirectory(const UnitDirectory&) = delete;
  UnitDirectory& operator=(const UnitDirectory&) = delete;

  bool done() const { return done_; }
  // Finished episodes: the first `episodes()` of the plan.
  size_t episodes() const { return rows_.size(); }

  // Writes provenance.json, or refuses to continue with another model than the one that began, or
  // with other files where `notes` has their hash.
  // `notes`: further keys of it.
  absl::Status CheckModel(const std::string& policy, const std::string& model_hash,
                          const std::map<std::string, std::string>& notes = {});
  // The session state that belongs to the rows; completes the rows from it when the last one is
  // missing. NOT_FOUND: there is none, it is damaged, or it belongs to other rows.
  absl::StatusOr<std::string> LoadAdapterState();
  // Forgets every episode.
  absl::Status Restart();

  // Where an episode's file of a kind lies, such as videos/task0_episode3.webp; makes the folder.
  absl::StatusOr<std::string> EpisodeFile(const char* folder, const PlannedEpisode& planned,
                                          const char* ending) const;
  // Adds a finished episode; adapter_state is null for methods without adaptation.
  absl::Status Append(const std::string& row, const std::string& timing,
                      const std::string* adapter_state);
  // Adds a line to servers.jsonl.
  absl::Status AppendServer(const std::string& row);
  // Publishes the adapter (null: none) and DONE.
  absl::Status Finish(const std::string* adapter);

 private:
  explicit UnitDirectory(std::string path) : path_(std::move(path)) {}
  absl::Status Lock();
  absl::Status CheckConfig(const UnitConfig& resolved);
  absl::Status LoadRows(const UnitConfig& resolved, const std::vector<PlannedEpisode>& plan);
  absl::Status CheckDone();
  absl::Status TrimTimings();
  std::string File(const char* name) const { return path_ + "/" + name; }
  std::string RowsText() const;

  const std::string path_;
  int lock_ = -1;  // descriptor of the directory, flock'ed
  bool done_ = false;
  size_t planned_ = 0;
  std::vector<std::string> rows_;
};

}  // namespace robostress
