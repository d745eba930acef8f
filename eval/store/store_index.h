#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

struct IndexResult {
  int read = 0, unchanged = 0, removed = 0;  // units
  std::vector<std::string> damaged;          // left out of episodes, each with its reason
};

// Brings the SQLite file `index` up to date with `stores` (run directories), reading only units
// whose files have changed since. The index is for questions and is never the truth: it can be
// deleted at any time, a rebuilt one answers the same, and no table is made from it.
//   units(store, unit, suite, scenario, severity, policy, method, seed, state, episodes, successes,
//         updates, wall_s, model_hash, episodes_sha256, machines, stamp), state finished |
//         unfinished | damaged
//   episodes(store, unit, task, episode, initial_state, success, steps, chunks, updates, residual,
//            intent), of finished units
// An index of another version of this schema is rebuilt. Internal when SQLite cannot use the file.
absl::StatusOr<IndexResult> UpdateIndex(const std::string& index,
                                        const std::vector<std::string>& stores);

}  // namespace robostress
