// grid_kills PROGRAMS SWEEP FOLDER KILLS SEED LONGEST_PAUSE_MS -- sweep arguments
// kills a sweep of the programs in PROGRAMS at random and compares its table; see random_kills.h.

#include <cstdio>
#include <cstdlib>

#include "tests/eval/launch/random_kills.h"

int main(int argc, char** argv) {
  if (argc < 9 || std::string(argv[7]) != "--") {
    std::fprintf(stderr,
                 "usage: %s PROGRAMS SWEEP FOLDER KILLS SEED LONGEST_PAUSE_MS -- sweep arguments\n",
                 argv[0]);
    return 2;
  }
  robostress::KillPlan plan;
  plan.programs = argv[1];
  plan.sweep = argv[2];
  plan.folder = argv[3];
  plan.kills = std::atoi(argv[4]);
  plan.seed = std::strtoull(argv[5], nullptr, 10);
  plan.longest_pause_ms = std::atoi(argv[6]);
  plan.arguments.assign(argv + 8, argv + argc);
  const absl::StatusOr<robostress::KillResult> result = robostress::KillAtRandom(plan);
  if (!result.ok()) {
    std::fprintf(stderr, "%s\n", std::string(result.status().message()).c_str());
    return 1;
  }
  std::printf(
      "%d kills (%d sweeps, %d workers, %d servers), %d commands, %d runs completed: every table "
      "is "
      "that of the undisturbed run, byte by byte\n",
      result->Kills(), result->sweeps_killed, result->workers_killed, result->servers_killed,
      result->commands, result->runs);
  return 0;
}
