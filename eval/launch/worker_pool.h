#pragma once

#include <deque>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/child_process.h"
#include "eval/launch/progress.h"
#include "eval/launch/server_source.h"
#include "eval/launch/signal_guard.h"
#include "eval/store/run_directory.h"
#include "eval/store/work_list.h"

namespace robostress {

// How workers are run; none of it may change a result.
struct PoolOptions {
  int workers = 1;
  bool measure_lag = false;
  bool record_joints = false;
  int record_views = 0;
  // How often an item whose server was lost is begun again before that is an error.
  int server_losses = 20;
  // The same for one item whose worker a signal killed, as where memory ran out.
  int kills_per_item = 3;
};

// What became of the items of one call.
struct PoolOutcome {
  int completed = 0;                // items
  std::vector<std::string> failed;  // names of items
  int signal = 0;                   // that ended it early; 0: none
};

// Runs items on worker processes, at most `workers` at a time, in the order given. An item that
// fails is reported with the end of its log, the others go on; one whose server was lost, or whose
// worker was killed, is run again. Unavailable when no server can be had, or an own server has
// ended.
class WorkerPool {
 public:
  WorkerPool(const RunDirectory& run, const PoolOptions& options, ServerSource& servers,
             SignalGuard& signals, Progress& progress)
      : run_(run), options_(options), servers_(servers), signals_(signals), progress_(progress) {}

  absl::Status Run(const std::vector<WorkItem>& items, PoolOutcome& outcome);

 private:
  struct Running {
    WorkItem item;
    ServerPlace place;
    ChildProcess process;
  };
  absl::Status Start(const WorkItem& item);
  void WaitForEvent();
  absl::Status Collect(PoolOutcome& outcome);

  const RunDirectory& run_;
  const PoolOptions& options_;
  ServerSource& servers_;
  SignalGuard& signals_;
  Progress& progress_;
  std::deque<WorkItem> waiting_;
  std::vector<Running> running_;
  int losses_ = 0;
  std::map<std::string, int> kills_;  // by item
};

}  // namespace robostress
