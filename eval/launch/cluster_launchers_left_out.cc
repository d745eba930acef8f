#include "absl/strings/str_cat.h"
#include "eval/launch/cluster_launchers.h"

namespace robostress {

std::vector<ClusterLauncher> ClusterLaunchers() { return {}; }

std::string LaunchersLeftOut() {
  return "; slurm and kubernetes are not in this build, which has ROBOSTRESS_CLUSTER=OFF";
}

absl::StatusOr<std::string> JobsInQueue(const RunDirectory& run) {
  return absl::UnimplementedError(absl::StrCat(
      run.path(),
      "/submissions: jobs of a cluster may still write in this run, and this build, "
      "with ROBOSTRESS_CLUSTER=OFF, cannot ask for them; finish the run with a build that can"));
}

}  // namespace robostress
