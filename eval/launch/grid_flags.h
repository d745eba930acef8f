#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/command_line.h"
#include "eval/launch/sweep_runner.h"
#include "eval/plan/plan.h"

namespace robostress {

// The command-line flags that describe a grid, shared by the commands that run one. A flag that is
// absent means "as in the grid that the command starts from".
struct GridFlags {
  std::string grid_file, robot;
  std::vector<std::string> suites, scenarios, policies, methods, overrides;
  std::vector<int> severities;
  std::vector<int64_t> seeds;
  std::string tasks;
  int episodes = 0, first_initial_state = 0, repeats = 0;
  std::string replay_file, libero_root, robosuite_root, libero_fixtures;
  std::vector<std::string> libero_tasks;
  std::string dialect, protocol;
  int latency_ms = 0;
  std::string late;
};

// --workers and --server of the programs that run a grid.
void DeclareLaunchFlags(cli::App& app, LaunchOptions& launch);
// --launcher and what belongs to it, --split-episodes, --quiet.
void DeclareClusterFlags(cli::App& app, LaunchOptions& launch);
// Where the policies of a launch are.
PolicyHome PolicyHomeOf(const LaunchOptions& launch);

// `flags` must outlive `app`'s parsing.
void DeclareGridFlags(cli::App& app, GridFlags& flags);
// Applies --grid's file and then every flag that was given to `grid`; the result is not resolved.
absl::Status ApplyGridFlags(const cli::App& app, const GridFlags& flags, SweepGrid& grid);

}  // namespace robostress
