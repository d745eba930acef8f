#pragma once

#include <memory>
#include <string>

#include "absl/status/statusor.h"
#include "common/child_process.h"

namespace robostress {

// A Slurm of one machine, from Debian's packages: munged, slurmctld and slurmd as children of this
// process, with their files in a folder of their own and free ports of the loopback. Four cores are
// pretended. Partition main can be preempted by partition urgent, which requeues its jobs.
class SlurmCluster {
 public:
  // Why it cannot be started here ("slurmctld is not installed"); empty when it can.
  static std::string WhyNot();
  // Unavailable, with the end of the daemons' log, when the node is not idle within two minutes or
  // does no job.
  static absl::StatusOr<std::unique_ptr<SlurmCluster>> Start(const std::string& folder);
  ~SlurmCluster();

  // "SLURM_CONF='...'", for commands of the shell.
  std::string Environment() const;
  // Runs a command of Slurm; its output.
  std::string Run(const std::string& command) const;

 private:
  explicit SlurmCluster(std::string folder) : folder_(std::move(folder)) {}
  absl::Status Launch();
  absl::Status RunsAJob() const;
  const std::string folder_;
  std::vector<ChildProcess> daemons_;
};

}  // namespace robostress
