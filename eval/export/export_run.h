#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// What becomes of a run's recorded episodes, and which.
struct ExportOptions {
  std::string run;
  std::string lerobot, libero, mcap;            // folders to make; empty: not wanted
  std::vector<std::string> methods, scenarios;  // empty: all; scenarios by their labels
  bool successes_only = false;
};

struct ExportSummary {
  int64_t episodes = 0, steps = 0;
  int64_t failures_left_out = 0;
  int64_t unfinished = 0;  // units of the run, of which nothing is written
  int64_t ticks = 0, samples = 0, pictures = 0, pictures_missing = 0;  // of an arm's run
  std::vector<std::string> written;                                    // folders and files
};

// Writes episodes that `sweep --record-episodes` left, in the run's canonical order:
//
//   lerobot/   a data set of LeRobot v3.0 (common/lerobot), pictures as PNG in Parquet:
//     observation.state [8]              what the policy was given
//     observation.joints [7], observation.joint_velocities [7]   [rad], [rad/s]
//     observation.images.image, .image2  agentview and wrist, before the step
//     action [7]                         commanded: the policy's own
//     action.sent [7]                    after corrections, as the controller got it
//     action.measured [7]                the displacement that came of it, in units of a command
//     meta/robostress_episodes.jsonl     which unit each episode is of
//   libero/TASK_demo.hdf5                common/libero/demonstrations.h, one file a task
//   mcap/UNIT-taskT-episodeE.mcap        eval/export/episode_mcap.h, one file an episode
//
// Of a run of robot_client one file, mcap/RUN.mcap (eval/export/arm_run_mcap.h).
//
// Folders that hold something are refused. NOT_FOUND names the episode that was not recorded;
// after an error what was begun is removed.
absl::StatusOr<ExportSummary> ExportRun(const ExportOptions& options);

}  // namespace robostress
