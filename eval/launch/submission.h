#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "eval/launch/launcher.h"

namespace robostress {

// What one call handed to a scheduler: RUN/submissions/NUMBER/, written before any job is
// submitted and never changed, so that a job that is requeued finds what it found before.
//   grid.yaml items.txt settings.json
//   servers/POLICY-INDEX.json  where a server job answers, while it does
//   left/INDEX                   a worker task that has nothing more to do: its exit code
// Item i belongs to worker task i modulo the number of tasks; the longest come first, so shares
// differ by little, and no task needs to talk to another.
class Submission {
 public:
  static absl::StatusOr<std::unique_ptr<Submission>> Create(const LaunchRequest& request);
  // DataLoss with the file when something in it is damaged or of another version.
  static absl::StatusOr<std::unique_ptr<Submission>> Open(const std::string& folder);

  const std::string& folder() const { return folder_; }
  std::string name() const;  // "0001"
  const RunDirectory& run() const { return run_; }
  int tasks() const { return tasks_; }
  int servers() const { return servers_; }  // per policy
  int server_threads() const { return server_threads_; }
  const std::string& server_host() const { return server_host_; }
  // Of --policy-url or --server; empty: servers are jobs.
  const std::vector<std::string>& elsewhere() const { return elsewhere_; }
  const PoolOptions& pool() const { return pool_; }
  const std::vector<WorkItem>& items() const { return items_; }
  std::vector<WorkItem> Share(int task) const;
  std::vector<PlannedUnit> UnitsOfItems() const;
  std::vector<std::string> ServedPolicies() const;

  std::string ServerFile(const std::string& policy, int index) const;
  // Marks a worker task that nobody will start again, and counts those that are marked.
  absl::Status Leave(int task, int exit_code) const;
  int TasksThatLeft() const;
  // How often a worker task ended by a failure of its own, this end included.
  absl::StatusOr<int> CountFailure(int task) const;

 private:
  explicit Submission(std::string folder, std::string run_dir)
      : folder_(std::move(folder)), run_(std::move(run_dir)) {}
  absl::Status Read();

  const std::string folder_;
  const RunDirectory run_;
  int tasks_ = 1, servers_ = 1, server_threads_ = 1;
  std::string server_host_;
  std::vector<std::string> elsewhere_;
  PoolOptions pool_;
  std::vector<PlannedUnit> units_;
  std::vector<WorkItem> items_;
};

}  // namespace robostress
