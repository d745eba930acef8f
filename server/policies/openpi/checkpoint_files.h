#pragma once

#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/safetensors.h"

namespace robostress::openpi {

// The files of a checkpoint that hold tensors.
struct ShardSet {
  std::string directory;  // where config.json and assets/ would lie
  std::vector<std::shared_ptr<const SafetensorsFile>> shards;
  // config.json in `directory` belongs to these files: they are a folder's, or called model.*.
  bool owns_directory = false;
};

// Maps the shards of a folder, a .safetensors file or an index. Refuses what is neither (with the
// way to convert openpi's JAX checkpoints), a folder with none or two, and an index that does not
// match its shards.
absl::StatusOr<ShardSet> OpenShards(const std::string& path);

// The weight_map of a model.safetensors.index.json: tensor -> name of the shard beside the index.
// Refuses names that leave the folder.
absl::StatusOr<std::map<std::string, std::string>> ParseShardIndex(const std::string& file,
                                                                   const std::string& json);

}  // namespace robostress::openpi
