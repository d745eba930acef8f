#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

struct KillPlan {
  std::string sweep;                   // program
  std::string programs;                // folder of worker and server: ROBOSTRESS_BIN
  std::vector<std::string> arguments;  // of the sweep, without --out
  std::string folder;                  // run directories are made in it
  int kills = 50;
  uint64_t seed = 0;
  int longest_pause_ms = 400;  // between kills, at first
};

struct KillResult {
  int sweeps_killed = 0, workers_killed = 0, servers_killed = 0;
  int runs = 0;      // run directories that were completed
  int commands = 0;  // how often the same command was given
  int Kills() const { return sweeps_killed + workers_killed + servers_killed; }
};

// Runs the sweep once undisturbed, then in fresh run directories with SIGKILL to a process drawn at
// random among the sweep, its workers and its servers, after a pause drawn at random; whenever the
// sweep has ended, the same command again, until it says that all is done. DataLoss when the
// episode table of such a run is not that of the undisturbed one, byte by byte. Pauses grow while
// nothing gets done between kills, so that the end does not depend on the machine's speed.
absl::StatusOr<KillResult> KillAtRandom(const KillPlan& plan);

}  // namespace robostress
