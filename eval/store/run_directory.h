#pragma once

#include <set>
#include <string>
#include <unordered_set>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "eval/plan/plan.h"

namespace robostress {

// Keeps a file locked (flock) for as long as it lives.
class FileLock {
 public:
  // FailedPrecondition with `busy` as its message when another process holds it.
  static absl::StatusOr<FileLock> Take(const std::string& file, const std::string& busy);
  FileLock(FileLock&& other) noexcept;
  FileLock& operator=(FileLock&&) = delete;
  ~FileLock();

 private:
  explicit FileLock(int fd) : fd_(fd) {}
  int fd_;
};

// Complete lines in a file; 0 when it is not there.
int CountLines(const std::string& file);

// NotFound lists the folders that are no run directories.
absl::Status CheckRunDirectories(const std::vector<std::string>& dirs);
// Paths of a run directory's unit folders, sorted.
absl::StatusOr<std::vector<std::string>> UnitFolders(const std::string& dir);

// Where things lie in a run directory:
//   sweep.yaml        the grid of the last call, resolved; grids/HASH.yaml every grid so far
//   plan/ID.yaml    configuration of a unit that has been started
//   units/ID/       written by its worker, DONE last
//   parts/ID/       ranges of a unit's episodes while they are run apart (work_list.h)
//   scenarios/        copies of scenario files, which is what is played
//   logs/             one per process
class RunDirectory {
 public:
  explicit RunDirectory(std::string path) : path_(std::move(path)) {}
  const std::string& path() const { return path_; }
  std::string Unit(const std::string& id) const { return path_ + "/units/" + id; }
  std::string Parts(const std::string& id) const { return path_ + "/parts/" + id; }
  std::string PlanFile(const std::string& id) const { return path_ + "/plan/" + id + ".yaml"; }
  std::string Log(const std::string& name) const { return path_ + "/logs/" + name + ".log"; }
  // Of a scenario file: where its copy lies.
  std::string KeptScenario(const std::string& scenario) const;
  bool Done(const std::string& id) const;
  // A worker has written something that belongs to one configuration.
  bool Begun(const std::string& id) const;
  // Names in units/ and parts/: asking them is cheaper than the disk when there are many units.
  std::unordered_set<std::string> StartedIds() const;

  // Only one sweep at a time.
  absl::StatusOr<FileLock> Lock() const;
  // FailedPrecondition, with every unit and file listed: units that were started with another
  // configuration, units that would be played unlike those that were started (played_alike.h),
  // scenario files, task folders and tables of fixtures that have changed.
  absl::Status CheckStarted(const SweepGrid& grid, const std::vector<PlannedUnit>& units) const;
  // Checks, makes the folders, keeps the grid and its scenario files.
  absl::Status Prepare(const SweepGrid& grid, const std::vector<PlannedUnit>& units) const;
  // Publishes a unit's configuration for its worker, which plays the kept copy of a scenario file:
  // the user's own may change while the sweep runs.
  absl::Status WritePlan(const PlannedUnit& unit) const;
  // Every grid that was planned here, oldest name first; DataLoss when a file is damaged.
  absl::StatusOr<std::vector<SweepGrid>> Grids() const;
  // Ids of the units that they plan, by what is kept of their scenarios; of a unit that `present`
  // has under its older id, that one.
  absl::StatusOr<std::set<std::string>> PlannedIds(const std::set<std::string>& present) const;

 private:
  UnitConfig AsPlayed(UnitConfig config) const;
  UnitConfig WithPlayedFilesOf(const std::string& id, UnitConfig config) const;
  const std::string path_;
};

}  // namespace robostress
