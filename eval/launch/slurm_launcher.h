#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "eval/launch/launcher.h"
#include "eval/launch/submission.h"

namespace robostress {

// Submits a grid to Slurm as three kinds of jobs, whose scripts lie in the submission's folder:
//   serve.sh   an array of server jobs per policy; ends when every worker task has left
//   work.sh    one array of worker tasks, each with its share of the items; starts after the
//   servers merge.sh   joins, merges and reports, once the last worker task has left the queue
// Everything is submitted with --requeue: a preempted job begins again and goes on where its files
// end. A worker task that finds no server requeues itself. Nothing of ours stays running on the
// submitting machine, unless cluster.wait asks for the progress.
class SlurmLauncher : public Launcher {
 public:
  // FailedPrecondition while jobs of an earlier call are in the queue; Unavailable when sbatch
  // fails, with what it said.
  absl::StatusOr<LaunchResult> Launch(const LaunchRequest& request) override;
};

// The scripts, as text.
std::string ServeScript(const Submission& submission, const std::string& policy);
std::string WorkScript(const Submission& submission);
std::string MergeScript(const Submission& submission);
// Prefix of the names of all jobs of a run directory.
std::string SlurmJobName(const RunDirectory& run);
// Ids of the jobs of a run directory that are in the queue; empty where there is no Slurm, and
// Unavailable where it does not answer.
absl::StatusOr<std::string> SlurmJobsInQueue(const RunDirectory& run);

}  // namespace robostress
