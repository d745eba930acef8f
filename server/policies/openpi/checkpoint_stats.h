#pragma once

#include <vector>

#include "absl/status/statusor.h"
#include "server/policies/openpi/checkpoint.h"
#include "server/policies/openpi/checkpoint_files.h"

namespace robostress::openpi {

// Where statistics lie, in the first of these places that has any: assets/ID/norm_stats.json
// (openpi), norm_stats.json, the state file of policy_preprocessor.json's normalizer (LeRobot),
// buffers among the weights (old LeRobot), assets/ of the parent folder (openpi's converter leaves
// them there). Nothing is read but LeRobot's list of steps; an empty result is no error.
absl::StatusOr<std::vector<NormStatsSource>> FindNormStats(const ShardSet& files);

}  // namespace robostress::openpi
