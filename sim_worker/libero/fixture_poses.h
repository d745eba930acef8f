#pragma once

#include <optional>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/libero/fixtures.h"
#include "sim_worker/libero/fixture_table.h"
#include "sim_worker/libero/numpy_placement.h"
#include "sim_worker/libero/scene.h"

namespace robostress::libero {

// Where the fixtures of one task stand at each episode, by the unit's choice. Not thread-safe.
class FixturePoses {
 public:
  // `scene` must outlive this. Reads a table at once and reports what is wrong with it.
  static absl::StatusOr<FixturePoses> Create(const LiberoFixtures& choice, const std::string& task,
                                             const LiberoScene& scene);
  // NotFound names every initial state of [first, first + count) that a table does not list.
  absl::Status CheckListed(int first, int count) const;
  // The poses of the episode that starts from this row of the task's initial states; equal rows
  // have equal poses. NotFound as CheckListed.
  absl::StatusOr<std::vector<FixturePose>> At(int initial_state);

 private:
  FixturePoses(const LiberoFixtures& choice, const std::string& task, const LiberoScene& scene)
      : choice_(choice), task_(task), scene_(&scene) {}

  LiberoFixtures choice_;
  std::string task_;
  const LiberoScene* scene_;
  FixtureTable table_;
  std::optional<NumpyPlacement> numpy_;
  std::vector<std::vector<FixturePose>> resets_;  // that numpy_ has drawn, in order
};

}  // namespace robostress::libero
