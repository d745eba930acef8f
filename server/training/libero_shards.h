#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "server/policies/nano/nano_config.h"

namespace robostress {

// Writes the demonstrations of a file in LIBERO's form (common/libero/demonstrations.h) as one
// shard: every `stride`-th step is a frame; its label is the actions from there on, after the end
// zero motion with the last gripper command, or the last target of a file of absolute actions.
//
// What the policy will be given when it is served decides how a frame looks. A file of this
// project's recorder carries it (obs/proprioception, upright views). LIBERO's own files do not:
// state is ee_pos, ee_ori, gripper_states, and views are mirrored left to right, as openpi's client
// turns them by 180 degrees and as the worker does for LIBERO's suites. Views are averaged to the
// policy's size. Without obs/aux the shard has no aux: it trains with aux_weight 0 only.
// The error names file, object and value.
absl::Status ConvertLiberoFile(const std::string& path, const NanoConfig& config, int stride,
                               const std::string& shard);

// The directories of shards to train from: `data` as given, where an .hdf5 file, or a directory
// that holds some, is converted into `converted` first. What is there already is not done again.
absl::StatusOr<std::vector<std::string>> PrepareShards(const std::vector<std::string>& data,
                                                       const NanoConfig& config, int stride,
                                                       const std::string& converted);

}  // namespace robostress
