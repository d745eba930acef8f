#include "server/policies/openpi/checkpoint_files.h"

#include <filesystem>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"
#include "server/policies/openpi/problem_list.h"

namespace robostress::openpi {
namespace {

namespace fs = std::filesystem;

constexpr char kSingle[] = "model.safetensors";
constexpr char kIndex[] = "model.safetensors.index.json";
constexpr char kIndexRemedy[] = "Take index and shards as they were written together";
constexpr uint64_t kMaxIndexBytes = 16 << 20;
constexpr size_t kMaxShards = 1024;

bool Exists(const fs::path& path) {
  std::error_code ignored;
  return fs::exists(path, ignored);
}

// Tensors that the index and the shards place differently.
absl::Status CheckPlaces(
    const std::string& index, const std::map<std::string, std::string>& weight_map,
    const std::map<std::string, std::shared_ptr<const SafetensorsFile>>& open) {
  std::vector<std::string> problems;
  for (const auto& [tensor, shard] : weight_map) {
    if (!open.at(shard)->tensors().contains(tensor))
      problems.push_back(
          absl::StrCat("weight_map places ", tensor, " in ", shard, ", which has no such tensor"));
  }
  for (const auto& [shard, file] : open) {
    for (const auto& [tensor, view] : file->tensors()) {
      const auto listed = weight_map.find(tensor);
      if (listed == weight_map.end()) {
        problems.push_back(
            absl::StrCat(shard, " holds ", tensor, ", which weight_map does not list"));
      } else if (listed->second != shard) {
        problems.push_back(absl::StrCat(shard, " holds ", tensor, ", which weight_map places in ",
                                        listed->second));
      }
    }
  }
  return ProblemList(index, "does not match its shards", problems, kIndexRemedy);
}

absl::StatusOr<ShardSet> OpenIndex(const fs::path& path) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path.string(), kMaxIndexBytes));
  RS_ASSIGN_OR_RETURN(const auto weight_map, ParseShardIndex(path.string(), text));
  ShardSet set;
  set.directory = path.parent_path().string();
  set.owns_directory = true;
  std::map<std::string, std::shared_ptr<const SafetensorsFile>> open;
  std::vector<std::string> absent;
  for (const auto& [tensor, shard] : weight_map) {
    if (open.contains(shard)) continue;
    const fs::path file = path.parent_path() / shard;
    open[shard] = nullptr;
    if (!Exists(file)) {
      absent.push_back(absl::StrCat(file.string(), " is not there"));
      continue;
    }
    RS_ASSIGN_OR_RETURN(SafetensorsFile mapped, SafetensorsFile::Open(file.string()));
    open[shard] = std::make_shared<const SafetensorsFile>(std::move(mapped));
  }
  RS_RETURN_IF_ERROR(ProblemList(path.string(), "lists shards that are missing", absent,
                                 "Fetch the missing files into the same folder"));
  RS_RETURN_IF_ERROR(CheckPlaces(path.string(), weight_map, open));
  for (auto& [shard, file] : open) set.shards.push_back(std::move(file));
  return set;
}

absl::StatusOr<ShardSet> OpenSingle(const fs::path& path) {
  RS_ASSIGN_OR_RETURN(SafetensorsFile file, SafetensorsFile::Open(path.string()));
  ShardSet set;
  set.directory = path.parent_path().string();
  set.owns_directory = path.filename() == kSingle;
  set.shards.push_back(std::make_shared<const SafetensorsFile>(std::move(file)));
  return set;
}

absl::StatusOr<ShardSet> OpenFolder(const fs::path& path) {
  const bool single = Exists(path / kSingle), index = Exists(path / kIndex);
  if (single && index) {
    return absl::InvalidArgumentError(absl::StrCat(path.string(), ": holds both ", kSingle, " and ",
                                                   kIndex, "; give the path of the one you mean"));
  }
  if (single) return OpenSingle(path / kSingle);
  if (index) return OpenIndex(path / kIndex);
  const bool jax = Exists(path / "params") || Exists(path / "_METADATA");
  return absl::NotFoundError(absl::StrCat(
      path.string(), ": holds neither ", kSingle, " nor ", kIndex,
      jax ? "; it looks like a JAX checkpoint: convert it with openpi's "
            "examples/convert_jax_model_to_pytorch.py"
          : "; give the folder of a PyTorch checkpoint of openpi or LeRobot, or the file itself"));
}

}  // namespace

absl::StatusOr<std::map<std::string, std::string>> ParseShardIndex(const std::string& file,
                                                                   const std::string& text) {
  const absl::StatusOr<nlohmann::json> json = ParseJsonObject(text);
  if (!json.ok())
    return absl::InvalidArgumentError(absl::StrCat(file, ": ", json.status().message()));
  const auto map = json->find("weight_map");
  if (map == json->end() || !map->is_object() || map->empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        file, ": 'weight_map' is not an object of tensors and their shards. ", kIndexRemedy));
  }
  std::map<std::string, std::string> weight_map;
  std::set<std::string> shards;
  for (const auto& [tensor, value] : map->items()) {
    const std::string shard = value.is_string() ? value.get<std::string>() : "";
    if (!absl::EndsWith(shard, ".safetensors") || absl::StrContains(shard, '/') ||
        absl::StrContains(shard, '\0')) {
      return absl::InvalidArgumentError(absl::StrCat(
          file, ": weight_map places ", tensor, " in ",
          value.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace).substr(0, 200),
          ", must be the name of a .safetensors file in the same folder. ", kIndexRemedy));
    }
    weight_map[tensor] = shard;
    shards.insert(shard);
  }
  if (shards.size() > kMaxShards) {
    return absl::InvalidArgumentError(absl::StrCat(file, ": weight_map names ", shards.size(),
                                                   " shards, the limit is ", kMaxShards));
  }
  return weight_map;
}

absl::StatusOr<ShardSet> OpenShards(const std::string& path) {
  std::error_code ignored;
  if (fs::is_directory(path, ignored)) return OpenFolder(path);
  if (absl::EndsWith(path, ".index.json")) return OpenIndex(path);
  return OpenSingle(path);
}

}  // namespace robostress::openpi
