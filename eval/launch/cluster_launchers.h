#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/launch/launcher.h"

// What a build knows of clusters. With ROBOSTRESS_CLUSTER=OFF cluster_launchers_left_out.cc stands
// in for cluster_launchers.cc and the files that it names.
namespace robostress {

struct ClusterLauncher {
  const char* name;
  std::unique_ptr<Launcher> (*make)();
};
std::vector<ClusterLauncher> ClusterLaunchers();
// What to add to the error about a launcher that is in neither table; empty with all of them.
std::string LaunchersLeftOut();

// Ids of the jobs of a run directory that are in a scheduler's queue; empty where there is no
// scheduler. Unavailable where it does not answer; Unimplemented where this build cannot ask.
absl::StatusOr<std::string> JobsInQueue(const RunDirectory& run);

}  // namespace robostress
