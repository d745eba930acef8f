#include "eval/launch/cluster_launchers.h"

#include "eval/launch/kubernetes_launcher.h"
#include "eval/launch/slurm_launcher.h"

namespace robostress {
namespace {

template <class T>
std::unique_ptr<Launcher> Make() {
  return std::make_unique<T>();
}

}  // namespace

std::vector<ClusterLauncher> ClusterLaunchers() {
  return {{"slurm", Make<SlurmLauncher>}, {"kubernetes", Make<KubernetesLauncher>}};
}

std::string LaunchersLeftOut() { return ""; }

absl::StatusOr<std::string> JobsInQueue(const RunDirectory& run) { return SlurmJobsInQueue(run); }

}  // namespace robostress
