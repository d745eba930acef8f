#include "eval/close_loop/recorded_run.h"

#include <utility>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<RunData> RunWholeGrid(const std::string& command, SweepGrid grid,
                                     const std::string& run_dir, int workers, bool record_joints) {
  RS_ASSIGN_OR_RETURN(grid, ResolveGrid(std::move(grid)));
  RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, ExpandUnits(grid));
  LaunchOptions launch;
  launch.run_dir = run_dir;
  launch.workers = workers;
  launch.record_joints = record_joints;
  AnnouncePlan(command, units, launch);
  RS_ASSIGN_OR_RETURN(MergedSweep merged, RunAndMerge(command, grid, units, launch));
  if (!merged.run || !merged.outcome.failed.empty() || merged.outcome.signal != 0)
    return absl::InternalError(
        absl::StrCat(run_dir, ": not all units are done; the same command goes on"));
  return *std::move(merged.run);
}

absl::StatusOr<RecordedRun> MakeRecordedRig(const std::string& run_dir, double rate_hz,
                                            uint64_t seed, const std::string& rig_dir) {
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> files,
                      calibration::FindJointLogs(run_dir, ""));
  RecordedRun arm;
  std::vector<calibration::RecordedEpisode> episodes;
  for (const std::string& file : files) {
    RS_ASSIGN_OR_RETURN(JointLog log, ReadJointLog(file));
    RS_ASSIGN_OR_RETURN(calibration::RecordedEpisode episode,
                        calibration::EpisodeOfJointLog(log, rate_hz));
    arm.logs.emplace(episode.name, std::move(log));
    episodes.push_back(std::move(episode));
  }
  calibration::RecordedRigOptions rig;
  rig.seed = seed;
  arm.contact_limit_N = rig.contact_limit_N;
  RS_ASSIGN_OR_RETURN(
      arm.rig, calibration::WriteRecordedRig(calibration::PandaOfRecordings("panda"), episodes, rig,
                                             rig_dir));
  return arm;
}

}  // namespace robostress
