#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "eval/plan.h"

namespace robostress {

// How a sweep is carried out; none of it may change a result.
struct LaunchOptions {
  std::string run_dir;
  int workers = 2;
  int server_start_timeout_s = 180;
  std::string server;  // HOST:PORT of a policy server that runs already; empty: one per policy
  bool quiet = false;  // no progress line
  // Adds lag_residual to every episode: its commands played again without joint errors.
  bool measure_lag = false;
  // Records the joints of every sub-step beside every episode, for `robostress record-to-rig`.
  bool record_joints = false;
};

// What happened to the units of this call.
struct SweepOutcome {
  int completed = 0;                // finished by this call
  int already_done = 0;             // had DONE before
  std::vector<std::string> failed;  // ids
  bool interrupted = false;
  double wall_s = 0;
};

// Runs the units that have no DONE yet, at most `workers` processes at a time, the longest first,
// with one policy server per policy that needs one, unless options.server is there. Layout of the
// run directory:
//   sweep.yaml plan/<id>.yaml units/<id>/ (written by the worker) logs/<id>.log
//   logs/server-<policy>.log launches.jsonl scenarios/<label>.yaml (copies of scenario files)
// A unit that fails is reported with the end of its log and the others go on. FailedPrecondition
// when the directory holds a unit of the same id with another configuration, or another sweep is
// running in it; Unavailable when a server does not start or dies.
absl::StatusOr<SweepOutcome> RunSweep(const SweepGrid& grid, const std::vector<PlannedUnit>& units,
                                      const LaunchOptions& options);

}  // namespace robostress
