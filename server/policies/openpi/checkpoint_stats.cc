#include "server/policies/openpi/checkpoint_stats.h"

#include <algorithm>
#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/json_text.h"
#include "common/status_macros.h"

namespace robostress::openpi {
namespace {

namespace fs = std::filesystem;
using Kind = NormStatsSource::Kind;

constexpr char kStatsJson[] = "norm_stats.json";
constexpr char kPreprocessor[] = "policy_preprocessor.json";
constexpr uint64_t kMaxJsonBytes = 1 << 20;
constexpr int kMaxAssetDepth = 3;       // ids like physical-intelligence/libero
constexpr int kMaxAssetEntries = 4096;  // of a folder that is no assets folder

bool IsFile(const fs::path& path) {
  std::error_code ignored;
  return fs::is_regular_file(path, ignored);
}

std::vector<NormStatsSource> InAssets(const fs::path& assets) {
  std::vector<NormStatsSource> found;
  std::error_code error;
  int entries = 0;
  for (fs::recursive_directory_iterator it(assets, error), end; !error && it != end;
       it.increment(error)) {
    if (++entries > kMaxAssetEntries) break;
    if (it.depth() >= kMaxAssetDepth) it.disable_recursion_pending();
    if (it->path().filename() != kStatsJson || !IsFile(it->path())) continue;
    found.push_back({Kind::kOpenpiJson, it->path().string(),
                     fs::relative(it->path().parent_path(), assets, error).string()});
  }
  std::sort(found.begin(), found.end(),
            [](const auto& a, const auto& b) { return a.asset_id < b.asset_id; });
  return found;
}

// The state file that the normalizer step of `preprocessor` names; empty where it names none.
absl::StatusOr<std::string> NormalizerFile(const fs::path& preprocessor) {
  const std::string path = preprocessor.string();
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMaxJsonBytes));
  const absl::StatusOr<nlohmann::json> json = ParseJsonObject(text);
  if (!json.ok())
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", json.status().message()));
  const auto steps = json->find("steps");
  if (steps == json->end() || !steps->is_array())
    return absl::InvalidArgumentError(absl::StrCat(path, ": 'steps' is not a list"));
  for (const nlohmann::json& step : *steps) {
    if (!step.is_object() ||
        step.value("registry_name", nlohmann::json()) != "normalizer_processor")
      continue;
    const auto file = step.find("state_file");
    if (file == step.end() || file->is_null()) continue;
    const std::string name = file->is_string() ? file->get<std::string>() : "";
    if (!absl::EndsWith(name, ".safetensors") || absl::StrContains(name, '/')) {
      return absl::InvalidArgumentError(
          absl::StrCat(path, ": state_file of normalizer_processor is ",
                       file->dump(-1, ' ', true).substr(0, 200),
                       ", must be the name of a .safetensors file in the same folder"));
    }
    const fs::path stats = preprocessor.parent_path() / name;
    if (!IsFile(stats)) {
      return absl::NotFoundError(
          absl::StrCat(path, ": state_file of normalizer_processor is ", name,
                       ", which is not there; fetch it into the same folder"));
    }
    return stats.string();
  }
  return std::string();
}

bool HasBuffers(const ShardSet& files) {
  return std::any_of(files.shards.begin(), files.shards.end(), [](const auto& shard) {
    return std::any_of(shard->tensors().begin(), shard->tensors().end(),
                       [](const auto& tensor) { return IsStatisticsBuffer(tensor.first); });
  });
}

std::string Describe(const NormStatsSource& source) {
  return source.asset_id.empty() ? source.file
                                 : absl::StrCat(source.asset_id, " (", source.file, ")");
}

// The one source that is meant.
absl::StatusOr<NormStatsSource> Choose(const Checkpoint& checkpoint, const std::string& asset_id) {
  std::vector<NormStatsSource> fitting;
  std::vector<std::string> known;
  for (const NormStatsSource& source : checkpoint.norm_stats) {
    if (asset_id.empty() || source.asset_id == asset_id) fitting.push_back(source);
    known.push_back(Describe(source));
  }
  if (fitting.size() == 1) return fitting.front();
  if (known.empty()) {
    return absl::NotFoundError(absl::StrCat(
        checkpoint.path,
        ": has no normalisation statistics: no assets/ID/norm_stats.json in its folder or the "
        "parent's, no norm_stats.json, no policy_preprocessor.json with a normalizer, no "
        "normalize_inputs buffers; copy the assets of its training beside it"));
  }
  return absl::InvalidArgumentError(
      absl::StrCat(checkpoint.path, ": asset id '", asset_id, "' fits ", fitting.size(),
                   " of its normalisation statistics, state one of: ", absl::StrJoin(known, ", ")));
}

absl::StatusOr<NormStats> Read(const Checkpoint& checkpoint, const NormStatsSource& source) {
  switch (source.kind) {
    case Kind::kOpenpiJson:
      return ReadNormStatsJson(source.file);
    case Kind::kLerobotNormalizer: {
      RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(source.file));
      return NormStatsOf(file);
    }
    case Kind::kLerobotBuffers:
      return NormStatsOf(checkpoint.shards);
  }
  return absl::InternalError("no such kind of statistics");
}

}  // namespace

absl::StatusOr<std::vector<NormStatsSource>> FindNormStats(const ShardSet& files) {
  const fs::path directory = files.directory.empty() ? "." : files.directory;
  if (files.owns_directory) {
    if (auto found = InAssets(directory / "assets"); !found.empty()) return found;
    if (IsFile(directory / kStatsJson))
      return std::vector<NormStatsSource>{
          {Kind::kOpenpiJson, (directory / kStatsJson).string(), ""}};
    if (IsFile(directory / kPreprocessor)) {
      RS_ASSIGN_OR_RETURN(const std::string file, NormalizerFile(directory / kPreprocessor));
      if (!file.empty()) return std::vector<NormStatsSource>{{Kind::kLerobotNormalizer, file, ""}};
    }
  }
  if (HasBuffers(files)) {
    return std::vector<NormStatsSource>{{Kind::kLerobotBuffers, files.shards.front()->path(), ""}};
  }
  if (!files.owns_directory) return std::vector<NormStatsSource>();
  std::error_code ignored;
  return InAssets(fs::absolute(directory, ignored).lexically_normal().parent_path() / "assets");
}

absl::StatusOr<NormStats> ReadNormStats(const Checkpoint& checkpoint, const std::string& asset_id) {
  RS_ASSIGN_OR_RETURN(const NormStatsSource source, Choose(checkpoint, asset_id));
  RS_ASSIGN_OR_RETURN(NormStats stats, Read(checkpoint, source));
  for (const char* key : {"state", "actions"}) {
    const auto field = stats.fields.find(key);
    if (field == stats.fields.end()) {
      return absl::InvalidArgumentError(
          absl::StrCat(source.file, ": has no statistics of '", key,
                       "'; take the file that was made with the checkpoint"));
    }
    if (static_cast<int64_t>(field->second.dims()) > checkpoint.config.action_dim) {
      return absl::InvalidArgumentError(absl::StrCat(
          source.file, ": ", key, ".mean has ", field->second.dims(), " values, the network of ",
          checkpoint.path, " has room for ", checkpoint.config.action_dim,
          "; take the file that was made with the checkpoint"));
    }
  }
  return stats;
}

}  // namespace robostress::openpi
