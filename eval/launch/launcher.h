#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/launch/cluster_options.h"
#include "eval/launch/progress.h"
#include "eval/launch/signal_guard.h"
#include "eval/launch/worker_pool.h"
#include "eval/store/run_directory.h"
#include "eval/store/work_list.h"

namespace robostress {

// How a sweep is carried out; none of it may change a result.
struct LaunchOptions {
  std::string run_dir;
  int workers = 2;
  int server_start_timeout_s = 180;
  std::string server;  // HOST:PORT of a policy server that runs already; empty: one per policy
  std::vector<std::string> policy_urls;  // of others' servers of one model, used side by side
  bool quiet = false;                    // no progress
  // Adds lag_residual to every episode: its commands played again without joint errors.
  bool measure_lag = false;
  // Records the joints of every sub-step beside every episode, for `robostress record-to-rig`.
  bool record_joints = false;
  // Above 0: records every step of every episode with views of as many pixels a side, for
  // `robostress export`.
  int record_views = 0;
  // Methods that carry nothing over run in parts of that many episodes; 0: undivided.
  int part_episodes = 0;
  std::string launcher = "local";  // one of LauncherNames()
  ClusterOptions cluster;          // of launchers other than local

  // Addresses of servers that run already; empty: they are started.
  std::vector<std::string> Elsewhere() const;
};

struct LaunchRequest {
  const RunDirectory& run;
  const SweepGrid& grid;
  const std::vector<WorkItem>& items;  // the longest first
  const LaunchOptions& options;
  SignalGuard& signals;
  Progress& progress;
};

struct LaunchResult {
  PoolOutcome outcome;
  bool submitted = false;  // others run it; nothing is known of it yet
  std::string hint;        // what a person does next
};

// Gets items done. What all launchers have in common is the run directory: they start workers that
// write there, and whatever happens to those, the same command completes the rest.
class Launcher {
 public:
  virtual ~Launcher() = default;
  virtual absl::StatusOr<LaunchResult> Launch(const LaunchRequest& request) = 0;
};

std::vector<std::string> LauncherNames();
// InvalidArgument with the known names for another one.
absl::StatusOr<std::unique_ptr<Launcher>> MakeLauncher(const std::string& name);

// Processes of this machine.
class LocalLauncher : public Launcher {
 public:
  absl::StatusOr<LaunchResult> Launch(const LaunchRequest& request) override;
};

}  // namespace robostress
