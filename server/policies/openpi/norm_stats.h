#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/safetensors.h"

namespace robostress::openpi {

// Statistics of one quantity over a data set, per dimension, in the units of the data. All that are
// there have the same length.
struct FieldStats {
  std::vector<double> mean, std;  // z-score; std >= 0
  std::vector<double> q01, q99;   // 1st and 99th percentile, q01 <= q99; empty where not recorded

  size_t dims() const { return mean.size(); }
  bool has_quantiles() const { return !q01.empty(); }
};

// What states and actions are normalised by. How (z-score or quantile, which epsilon) is the
// policy's business, see checkpoint.h.
struct NormStats {
  std::map<std::string, FieldStats> fields;  // openpi's keys: "state", "actions", others as stored
  std::string source;                        // the file that they were read from
};

// openpi's norm_stats.json: {"norm_stats": {KEY: {"mean": [..], "std": [..], "q01": .., "q99":
// ..}}}; q01 and q99 may be null or absent, but only together. The error lists every field that is
// missing, of another length, not finite, a negative std or q99 < q01, each with index and value.
absl::StatusOr<NormStats> ParseNormStats(const std::string& file, const std::string& json);
absl::StatusOr<NormStats> ReadNormStatsJson(const std::string& path);

// LeRobot's normalizer file (observation.state.mean, action.q99, ...), or, where it is a weights
// file of the old generation, its buffers (normalize_inputs.buffer_observation_state.mean,
// unnormalize_outputs.buffer_action.std, ...). Becomes "state" and "actions"; statistics of images
// are left out. Same refusals; buffers that were never filled hold infinities and are refused.//
// Shards count as one file.
absl::StatusOr<NormStats> NormStatsOf(
    const std::vector<std::shared_ptr<const SafetensorsFile>>& shards);
absl::StatusOr<NormStats> NormStatsOf(const SafetensorsFile& file);

// True for tensors of an old weights file that only hold statistics.
bool IsStatisticsBuffer(const std::string& tensor);

}  // namespace robostress::openpi
