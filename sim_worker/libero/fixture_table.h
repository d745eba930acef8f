#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "sim_worker/libero/scene.h"

namespace robostress::libero {

// Poses by the index of the initial state.
using FixtureTable = std::map<int, std::vector<FixturePose>>;

// The part of a JSON file that holds one task's fixtures:
//   {"TASK": {"INITIAL_STATE": {"FIXTURE": {"pos": [x, y, z], "quat": [w, x, y, z]}}}}
// with positions in the world [m] and unit quaternions. Every initial state that is listed must
// give every fixture of `scene` that an init atom places, and no other name; a task without such
// fixtures may be absent. Errors name file, task, initial state and fixture.
absl::StatusOr<FixtureTable> ReadFixtureTable(const std::string& file, const std::string& task,
                                              const LiberoScene& scene);

}  // namespace robostress::libero
