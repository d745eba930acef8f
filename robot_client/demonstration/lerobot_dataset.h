#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "nlohmann/json.hpp"
#include "robot_client/demonstration/demonstration.h"

namespace robostress {

// Where a set keeps its table of an episode: folder "data" or "meta/episodes".
std::string LerobotEpisodeFile(const std::string& directory, const char* folder, int64_t episode);

// A data set in LeRobot's form, v3.0, that grows by whole episodes:
//
//   meta/info.json                            schema and counts; written last, so it alone says
//                                             which episodes there are
//   meta/tasks.parquet, meta/stats.json
//   meta/episodes/chunk-CCC/file-FFF.parquet  one episode each
//   data/chunk-CCC/file-FFF.parquet           its ticks: observation.state [7], action [7],
//                                             observation.images.CAMERA (JPEG), timestamp, indices,
//                                             next.reward, next.done, next.success
//
// A process that is killed leaves the episodes of the last info.json; files beyond them are
// removed when the set is opened again. One process at a time.
class LerobotDataset {
 public:
  // Makes the set, or goes on with the one in `directory`; then its schema must be the same: the
  // error names field and values. `cameras` with their pictures' width and height.
  static absl::StatusOr<LerobotDataset> Open(const std::string& directory, const std::string& robot,
                                             double rate_hz,
                                             const std::vector<std::string>& cameras);

  // On failure the set is as it was.
  absl::Status Append(const DemonstrationEpisode& episode);

  int64_t episodes() const { return info_.at("total_episodes").get<int64_t>(); }
  int64_t frames() const { return info_.at("total_frames").get<int64_t>(); }

 private:
  LerobotDataset(std::string directory, nlohmann::ordered_json info)
      : directory_(std::move(directory)), info_(std::move(info)) {}
  absl::Status WriteTables(const nlohmann::ordered_json& info) const;
  void RemoveUnfinished() const;

  std::string directory_;
  nlohmann::ordered_json info_;  // meta/info.json
};

}  // namespace robostress
