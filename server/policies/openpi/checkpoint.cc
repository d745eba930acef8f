#include "server/policies/openpi/checkpoint.h"

#include <torch/types.h>

#include <algorithm>
#include <filesystem>
#include <set>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "server/policies/openpi/checkpoint_files.h"
#include "server/policies/openpi/checkpoint_layout.h"
#include "server/policies/openpi/checkpoint_sizes.h"
#include "server/policies/openpi/checkpoint_stats.h"
#include "server/policies/openpi/openpi_weights.h"
#include "server/policies/openpi/problem_list.h"
#include "server/policies/tensor_io.h"

namespace robostress::openpi {
namespace {

constexpr uint64_t kMaxConfigBytes = 1 << 20;

absl::Status NoNetwork(const std::string& path, const std::string& network) {
  return absl::InvalidArgumentError(
      absl::StrCat(path, ": holds none of the tensors of a ", network,
                   " network, so it is no weights file; give the one with openpi's or LeRobot's "
                   "names"));
}

// "NAME", or "NAME (stored as X in FILE)" where that says more.
std::string Describe(const Checkpoint& checkpoint, const std::string& name,
                     const StoredTensor& stored) {
  std::vector<std::string> more;
  if (stored.stored_name != name) more.push_back(absl::StrCat("stored as ", stored.stored_name));
  if (checkpoint.shards.size() > 1) {
    const auto file = std::filesystem::path(stored.shard->path()).filename().string();
    more.push_back(absl::StrCat("in ", file));
  }
  return more.empty() ? name : absl::StrCat(name, " (", absl::StrJoin(more, " "), ")");
}

// Puts every stored tensor under openpi's name and sees the layout. Two that mean the same tensor
// are an error.
absl::Status CollectTensors(Checkpoint& checkpoint) {
  std::vector<std::string> twice;
  for (const auto& shard : checkpoint.shards) {
    for (const auto& [stored_name, view] : shard->tensors()) {
      const OpenpiName mapped = ToOpenpiName(stored_name);
      checkpoint.layout = std::max(checkpoint.layout, mapped.layout);
      const StoredTensor tensor{shard, stored_name, view};
      const auto [found, added] = checkpoint.tensors.emplace(mapped.name, tensor);
      if (added) continue;
      twice.push_back(absl::StrCat(mapped.name, ": as ", found->second.stored_name, " in ",
                                   found->second.shard->path(), " and as ", stored_name, " in ",
                                   shard->path()));
    }
  }
  return ProblemList(checkpoint.path, "stores tensors twice", twice,
                     "Take the files as they were written together");
}

// `__metadata__.config` of the shards, which must be the same where several have it.
absl::StatusOr<std::optional<OpenpiConfig>> ConfigInMetadata(const Checkpoint& checkpoint) {
  const SafetensorsFile* first = nullptr;
  for (const auto& shard : checkpoint.shards) {
    const auto found = shard->metadata().find("config");
    if (found == shard->metadata().end()) continue;
    if (first == nullptr) first = shard.get();
    if (first->metadata().at("config") != found->second) {
      return absl::InvalidArgumentError(
          absl::StrCat(shard->path(), ": metadata 'config' differs from that of ", first->path(),
                       "; the shards are not of one checkpoint"));
    }
  }
  if (first == nullptr) return std::nullopt;
  RS_ASSIGN_OR_RETURN(OpenpiConfig config, OpenpiConfigOf(*first));
  return std::optional<OpenpiConfig>(config);
}

// config.json beside the files. A file of its own name that says its sizes itself stands alone.
absl::StatusOr<CheckpointConfig> ReadDeclared(const ShardSet& files, bool says_sizes) {
  const std::string path = (std::filesystem::path(files.directory) / "config.json").string();
  std::error_code ignored;
  if (!std::filesystem::exists(path, ignored) || (says_sizes && !files.owns_directory))
    return CheckpointConfig();
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, kMaxConfigBytes));
  return ParseCheckpointConfig(path, text);
}

// What a network must hold: name, shape.
struct ShapeCollector : ParameterVisitor {
  void OnTensor(const std::string& name, const std::vector<int64_t>& shape,
                torch::Tensor&) override {
    shapes.emplace_back(name, shape);
  }
  std::vector<std::pair<std::string, std::vector<int64_t>>> shapes;
};

using Tensors = std::map<std::string, StoredTensor>;

// The tensor that holds `name`, which for the embedding may go by its tied name.
Tensors::const_iterator FindStored(const Tensors& tensors, const std::string& name) {
  const auto found = tensors.find(name);
  return found == tensors.end() && name == kEmbeddingName ? tensors.find(kTiedHeadName) : found;
}

bool IsFloat(DType dtype) {
  return dtype == DType::kF32 || dtype == DType::kBF16 || dtype == DType::kF16;
}

// Keeps the network's tensors in `checkpoint.tensors` and names everything that does not fit.
absl::Status MatchTensors(bool lerobot, Checkpoint& checkpoint) {
  const OpenpiConfig& config = checkpoint.config;
  ShapeCollector wanted;
  OpenpiWeights nothing;
  VisitParameters(config, nothing, wanted);
  Tensors stored = std::exchange(checkpoint.tensors, {});
  std::vector<std::string> problems;
  for (const auto& [name, shape] : wanted.shapes) {
    const auto found = FindStored(stored, name);
    if (found == stored.end()) {
      problems.push_back(absl::StrCat("missing: ", name, " ", ShapeText(shape)));
      continue;
    }
    const StoredTensor& tensor = found->second;
    if (tensor.view.shape != shape) {
      problems.push_back(absl::StrCat("misshaped: ", Describe(checkpoint, name, tensor), " is ",
                                      ShapeText(tensor.view.shape), ", the configuration asks for ",
                                      ShapeText(shape)));
    } else if (!IsFloat(tensor.view.dtype)) {
      problems.push_back(absl::StrCat("dtype: ", Describe(checkpoint, name, tensor), " is ",
                                      DTypeName(tensor.view.dtype), ", must be F32, BF16 or F16"));
    }
    checkpoint.tensors.insert({name, tensor});
    stored.erase(found);
  }
  if (checkpoint.tensors.empty()) return NoNetwork(checkpoint.path, config.name());
  for (const auto& [name, tensor] : stored) {
    if (name == kTiedHeadName || IsUnusedTensor(name, lerobot && config.pi05)) {
      checkpoint.unused.push_back(tensor.stored_name);
    } else {
      problems.push_back(absl::StrCat("unexpected: ", Describe(checkpoint, name, tensor), " ",
                                      ShapeText(tensor.view.shape)));
    }
  }
  return ProblemList(
      checkpoint.path,
      absl::StrCat("its tensors do not make the ", config.name(), " network of its configuration"),
      problems,
      "Take a whole checkpoint of openpi or LeRobot with the config.json that "
      "belongs to it");
}

// Before sizes are derived: some tensor has a name of the network.
absl::Status CheckNetwork(const Checkpoint& checkpoint) {
  const bool any = std::any_of(checkpoint.tensors.begin(), checkpoint.tensors.end(),
                               [](const auto& entry) { return IsNetworkName(entry.first); });
  return any ? absl::OkStatus() : NoNetwork(checkpoint.path, "pi0 or pi0.5");
}

void RenameTimeMlp(Checkpoint& checkpoint) {
  Tensors renamed;
  for (auto& [name, tensor] : checkpoint.tensors) {
    const std::string other = TimeMlpName(name, checkpoint.config.pi05);
    const bool taken = other != name && checkpoint.tensors.contains(other);
    renamed.emplace(taken ? name : other, std::move(tensor));
  }
  checkpoint.tensors = std::move(renamed);
}

}  // namespace

uint64_t Checkpoint::file_bytes() const {
  uint64_t bytes = 0;
  for (const auto& shard : shards) bytes += shard->file_bytes();
  return bytes;
}

uint64_t Checkpoint::tensor_bytes() const {
  uint64_t bytes = 0;
  for (const auto& [name, tensor] : tensors) bytes += tensor.view.bytes.size();
  return bytes;
}

std::string Checkpoint::stored_precision() const {
  std::set<std::string> dtypes;
  for (const auto& [name, tensor] : tensors) dtypes.insert(DTypeName(tensor.view.dtype));
  return absl::StrJoin(dtypes, " and ");
}

absl::StatusOr<Checkpoint> OpenCheckpoint(const std::string& path,
                                          const CheckpointOptions& options) {
  RS_ASSIGN_OR_RETURN(const ShardSet files, OpenShards(path));
  Checkpoint checkpoint;
  checkpoint.path = path;
  checkpoint.shards = files.shards;
  RS_RETURN_IF_ERROR(CollectTensors(checkpoint));
  RS_ASSIGN_OR_RETURN(const std::optional<OpenpiConfig> stated, ConfigInMetadata(checkpoint));
  RS_ASSIGN_OR_RETURN(checkpoint.declared, ReadDeclared(files, stated.has_value()));
  const SizeSources sources{path, checkpoint.tensors, checkpoint.declared, options};
  if (stated) {
    checkpoint.config = *stated;
  } else {
    RS_RETURN_IF_ERROR(CheckNetwork(checkpoint));
    RS_ASSIGN_OR_RETURN(const bool pi05, DetectPi05(sources));
    RS_ASSIGN_OR_RETURN(checkpoint.config, DeriveSizes(sources, pi05, checkpoint.notes));
  }
  RS_RETURN_IF_ERROR(CheckDeclared(sources, checkpoint.config));
  const bool lerobot = checkpoint.layout != CheckpointLayout::kOpenpi ||
                       checkpoint.declared.writer == CheckpointConfig::Writer::kLerobot;
  if (lerobot) RenameTimeMlp(checkpoint);
  RS_RETURN_IF_ERROR(MatchTensors(lerobot, checkpoint));
  RS_ASSIGN_OR_RETURN(checkpoint.norm_stats, FindNormStats(files));
  return checkpoint;
}

}  // namespace robostress::openpi
