#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/safetensors_stream.h"
#include "server/policies/openpi/checkpoint_generator.h"
#include "server/policies/openpi/norm_stats.h"

namespace robostress::openpi {

// What a generated checkpoint holds beside its weights.

// Random statistics of 8 state and 7 action entries, quantiles at mean -+ 2 std.
NormStats RandomNormStats(uint64_t seed);

// config.json and the statistics where the layout's writer puts them: assets/generated, or the
// normalizer of policy_preprocessor.json, or nothing (old LeRobot: buffers among the weights).
absl::Status WriteSideFiles(const GeneratorOptions& options, const OpenpiConfig& config,
                            const std::string& folder);

// The old LeRobot's buffers: entries for a weights file, float32, and their values in order.
void AddStatisticsBuffers(uint64_t seed, std::vector<SafetensorsStream::Entry>& entries,
                          std::vector<float>& values);

std::string ShardName(int64_t shard, int64_t shards);  // from 1
std::string IndexJson(const std::map<std::string, std::string>& weight_map, uint64_t total_bytes);

}  // namespace robostress::openpi
