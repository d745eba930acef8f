#pragma once

#include <sys/types.h>

#include <cstdint>
#include <cstdio>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/types.h"
#include "nlohmann/json.hpp"

namespace robostress {

// What a set holds of every control step, beside its pictures.
struct LerobotSchema {
  struct Vector {
    std::string name;               // of the feature, such as observation.state
    std::vector<std::string> axes;  // names of its entries
  };
  std::string robot;
  double rate_hz = 0;  // a whole number from 1 to 1000
  std::vector<Vector> vectors;
  std::vector<std::string> cameras;  // observation.images.CAMERA
};

// A whole episode of T steps.
struct LerobotEpisode {
  std::string instruction;
  bool success = false;
  size_t steps = 0;
  std::vector<std::vector<float>> vectors;         // per feature of the schema [T * axes]
  std::vector<std::vector<std::string>> pictures;  // per camera [T], JPEG or PNG
  const char* picture_ending = "png";              // or jpg
  std::vector<int> width, height;                  // of them, per camera [px]
  std::vector<std::vector<Image>> small;           // the same, of any size, for statistics
};

// Where a set keeps its table of an episode: folder "data" or "meta/episodes".
std::string LerobotEpisodeFile(const std::string& directory, const char* folder, int64_t episode);

// A data set in LeRobot's form, v3.0, that grows by whole episodes:
//
//   meta/info.json                            schema and counts; written last, so it alone says
//                                             which episodes there are
//   meta/tasks.parquet, meta/stats.json
//   meta/episodes/chunk-CCC/file-FFF.parquet  one episode each
//   data/chunk-CCC/file-FFF.parquet           its steps: the schema's vectors,
//                                             observation.images.CAMERA, timestamp, indices,
//                                             next.reward, next.done, next.success
//   meta/.lock                                one recorder a folder: it holds this file
//   meta/.begun                               until the first info.json: what is here is ours
//
// A process that is killed leaves the episodes of the last info.json; files beyond them are
// removed when the set is opened again. Data that has neither info.json nor meta/.begun is
// somebody else's: it is refused and stays.
class LerobotDataset {
 public:
  // Makes the set, or goes on with the one in `directory`; then its schema must be the same: the
  // error names field and values. FAILED_PRECONDITION while another recorder has it open.
  static absl::StatusOr<LerobotDataset> Open(const std::string& directory,
                                             const LerobotSchema& schema);

  // On failure the set is as it was.
  absl::Status Append(const LerobotEpisode& episode);

  int64_t episodes() const { return info_.at("total_episodes").get<int64_t>(); }
  int64_t frames() const { return info_.at("total_frames").get<int64_t>(); }

 private:
  // A forked child has the file, too: it must neither keep the lock nor take it from its parent.
  struct Release {
    pid_t owner;
    void operator()(std::FILE* file) const;
  };
  using Lock = std::unique_ptr<std::FILE, Release>;

  LerobotDataset(std::string directory, LerobotSchema schema, nlohmann::ordered_json info,
                 Lock lock)
      : directory_(std::move(directory)),
        schema_(std::move(schema)),
        info_(std::move(info)),
        lock_(std::move(lock)) {}
  static absl::StatusOr<Lock> TakeLock(const std::string& directory);
  absl::Status WriteTables(const nlohmann::ordered_json& info) const;
  void RemoveUnfinished() const;

  std::string directory_;
  LerobotSchema schema_;
  nlohmann::ordered_json info_;  // meta/info.json
  Lock lock_;
};

}  // namespace robostress
