#include "server/policies/openpi/checkpoint_generator.h"

#include <torch/types.h>
#include <unistd.h>

#include <algorithm>
#include <bit>
#include <cmath>
#include <filesystem>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/random.h"
#include "common/status_macros.h"
#include "server/policies/openpi/checkpoint_layout.h"
#include "server/policies/openpi/generated_files.h"
#include "server/policies/openpi/openpi_weights.h"

namespace robostress::openpi {
namespace {

namespace fs = std::filesystem;

constexpr int64_t kBlock = 1 << 20;  // elements written at a time
constexpr int64_t kMaxShards = 999;

// A tensor to write and openpi's name of it, on which its values depend.
struct Planned {
  SafetensorsStream::Entry entry;
  std::string name;
};

struct NameCollector : ParameterVisitor {
  void OnTensor(const std::string& name, const std::vector<int64_t>& shape,
                torch::Tensor&) override {
    names.emplace_back(name, shape);
  }
  std::vector<std::pair<std::string, std::vector<int64_t>>> names;
};

OpenpiConfig ConfigOf(const GeneratorOptions& options) {
  return options.full ? FullConfig(options.pi05) : TinyGeneratedConfig(options.pi05);
}

std::vector<Planned> Plan(const GeneratorOptions& options) {
  const OpenpiConfig config = ConfigOf(options);
  NameCollector collector;
  OpenpiWeights nothing;
  VisitParameters(config, nothing, collector);
  collector.names.emplace_back(kUnusedHeadName,
                               std::vector<int64_t>{config.vocab, config.expert_width});
  std::vector<Planned> plan;
  for (const auto& [name, shape] : collector.names) {
    // safetensors' save_model keeps the first name of a tied pair, old LeRobot files the other.
    const bool tied = name == kEmbeddingName && options.layout != CheckpointLayout::kLerobotOld;
    plan.push_back(
        {{ToStoredName(tied ? kTiedHeadName : name, options.layout), options.dtype, shape}, name});
  }
  return plan;
}

uint64_t Mix(uint64_t x) {  // splitmix64
  x += 0x9E3779B97F4A7C15;
  x = (x ^ (x >> 30)) * 0xBF58476D1CE4E5B9;
  x = (x ^ (x >> 27)) * 0x94D049BB133111EB;
  return x ^ (x >> 31);
}

// The stream of one tensor: element i is uniform in (-limit, limit) in steps of 2^-15 of it.
class Values {
 public:
  Values(uint64_t seed, const std::string& name, const std::vector<int64_t>& shape)
      : key_(StreamKey("weights").With(static_cast<int64_t>(seed)).With(name).lo()) {
    double in = 1;
    for (size_t i = 1; i < shape.size(); ++i) in *= static_cast<double>(shape[i]);
    const double std = shape.size() > 1 ? 1 / std::sqrt(in) : 0.1;  // vectors: biases and norms
    scale_ = static_cast<float>(std * std::sqrt(3.0) / 32768);
  }
  // Four at a time; `first` is a multiple of 4.
  void Fill(int64_t first, std::vector<float>& values) const {
    for (size_t i = 0; i < values.size(); i += 4) {
      const uint64_t bits = Mix(key_ + (first + i) / 4);
      for (size_t j = 0; j < 4 && i + j < values.size(); ++j) {
        const auto quarter = static_cast<int32_t>((bits >> (16 * j)) & 0xFFFF);
        values[i + j] = (static_cast<float>(quarter) - 32767.5f) * scale_;
      }
    }
  }

 private:
  uint64_t key_;
  float scale_ = 0;
};

// To bfloat16, to nearest, ties to even; finite input.
uint16_t ToBf16(float value) {
  const uint32_t bits = std::bit_cast<uint32_t>(value);
  return static_cast<uint16_t>((bits + 0x7FFF + ((bits >> 16) & 1)) >> 16);
}

absl::Status WriteTensor(const GeneratorOptions& options, const Planned& planned,
                         SafetensorsStream& stream) {
  const int64_t elements =
      static_cast<int64_t>(planned.entry.bytes()) / DTypeSize(planned.entry.dtype);
  const Values source(options.seed, planned.name, planned.entry.shape);
  std::vector<float> values;
  std::vector<uint16_t> rounded;
  for (int64_t first = 0; first < elements; first += kBlock) {
    values.resize(std::min(kBlock, elements - first));
    source.Fill(first, values);
    if (options.dtype == DType::kF32) {
      RS_RETURN_IF_ERROR(stream.Append(
          {reinterpret_cast<const uint8_t*>(values.data()), values.size() * sizeof(float)}));
      continue;
    }
    rounded.resize(values.size());
    for (size_t i = 0; i < values.size(); ++i) rounded[i] = ToBf16(values[i]);
    RS_RETURN_IF_ERROR(stream.Append(
        {reinterpret_cast<const uint8_t*>(rounded.data()), rounded.size() * sizeof(uint16_t)}));
  }
  return absl::OkStatus();
}

std::map<std::string, std::string> MetadataOf(const GeneratorOptions& options) {
  std::map<std::string, std::string> metadata = {{"format", "pt"}};
  if (options.layout == CheckpointLayout::kOpenpi) metadata[kEmbeddingName] = kTiedHeadName;
  if (!options.full) metadata["config"] = OpenpiConfigJson(ConfigOf(options));
  return metadata;
}

// Writes the tensors `first`..`last` as one file. An old LeRobot file begins with its statistics.
absl::Status WriteShard(const GeneratorOptions& options, const fs::path& path,
                        absl::Span<const Planned> tensors, bool with_statistics) {
  std::vector<SafetensorsStream::Entry> entries;
  std::vector<float> statistics;
  if (with_statistics) AddStatisticsBuffers(options.seed, entries, statistics);
  for (const Planned& planned : tensors) entries.push_back(planned.entry);
  RS_ASSIGN_OR_RETURN(SafetensorsStream stream,
                      SafetensorsStream::Create(path.string(), MetadataOf(options), entries));
  RS_RETURN_IF_ERROR(stream.Append(
      {reinterpret_cast<const uint8_t*>(statistics.data()), statistics.size() * sizeof(float)}));
  for (const Planned& planned : tensors) RS_RETURN_IF_ERROR(WriteTensor(options, planned, stream));
  return stream.Finish();
}

absl::Status WriteWeights(const GeneratorOptions& options, const fs::path& folder) {
  const std::vector<Planned> plan = Plan(options);
  const bool buffers = options.layout == CheckpointLayout::kLerobotOld;
  if (options.shards == 1) return WriteShard(options, folder / "model.safetensors", plan, buffers);
  std::map<std::string, std::string> weight_map;
  uint64_t total = 0;
  if (buffers) {
    std::vector<SafetensorsStream::Entry> statistics;
    std::vector<float> values;
    AddStatisticsBuffers(options.seed, statistics, values);
    for (const auto& entry : statistics) weight_map[entry.name] = ShardName(1, options.shards);
  }
  for (const Planned& planned : plan) total += planned.entry.bytes();
  size_t first = 0;
  uint64_t written = 0;
  for (int64_t shard = 1; shard <= options.shards; ++shard) {
    // Up to its part of all bytes, but one tensor at least and one for each shard that follows.
    size_t last = first;
    while (last < plan.size() - (options.shards - shard) &&
           (last == first || written + plan[last].entry.bytes() <= total / options.shards * shard ||
            shard == options.shards)) {
      written += plan[last].entry.bytes();
      weight_map[plan[last].entry.name] = ShardName(shard, options.shards);
      ++last;
    }
    RS_RETURN_IF_ERROR(WriteShard(options, folder / ShardName(shard, options.shards),
                                  absl::MakeSpan(plan).subspan(first, last - first),
                                  buffers && shard == 1));
    first = last;
  }
  return WriteFileAtomically((folder / "model.safetensors.index.json").string(),
                             IndexJson(weight_map, total));
}

absl::Status CheckOptions(const GeneratorOptions& options) {
  if (options.layout == CheckpointLayout::kLerobotOld && options.pi05) {
    return absl::InvalidArgumentError(
        "layout lerobot_old has no pi0.5, which came later; take layout lerobot or openpi");
  }
  if (options.shards < 1 || options.shards > kMaxShards ||
      options.shards > static_cast<int64_t>(Plan(options).size())) {
    return absl::InvalidArgumentError(absl::StrCat("shards is ", options.shards, ", must be in 1..",
                                                   kMaxShards, " and no more than the ",
                                                   Plan(options).size(), " tensors"));
  }
  std::error_code ignored;
  if (options.out.empty() || fs::exists(options.out, ignored)) {
    return absl::AlreadyExistsError(
        absl::StrCat("out is '", options.out, "', must be a folder that does not exist yet"));
  }
  return absl::OkStatus();
}

}  // namespace

OpenpiConfig FullConfig(bool pi05) {
  OpenpiConfig c;
  c.pi05 = pi05;
  c.image = 224, c.patch = 14;
  c.vision_width = 1152, c.vision_depth = 27, c.vision_heads = 16, c.vision_mlp = 4304;
  c.prefix_width = 2048, c.prefix_mlp = 16384, c.expert_width = 1024, c.expert_mlp = 4096;
  c.depth = 18, c.heads = 8, c.kv_heads = 1, c.head_dim = 256;
  c.vocab = 257152, c.horizon = 50, c.action_dim = 32, c.prompt_tokens = pi05 ? 200 : 48;
  return c;
}

OpenpiConfig TinyGeneratedConfig(bool pi05) {
  OpenpiConfig c;
  c.pi05 = pi05;
  c.image = 28, c.patch = 14;
  c.vision_width = 32, c.vision_depth = 2, c.vision_heads = 4, c.vision_mlp = 52;
  c.prefix_width = 48, c.prefix_mlp = 80, c.expert_width = 40, c.expert_mlp = 64;
  c.depth = 3, c.heads = 4, c.kv_heads = 1, c.head_dim = 16;
  c.vocab = 300, c.horizon = 8, c.action_dim = 32, c.prompt_tokens = pi05 ? 200 : 48;
  c.state_dim = 8;
  return c;
}

std::vector<SafetensorsStream::Entry> CheckpointTensors(const GeneratorOptions& options) {
  std::vector<SafetensorsStream::Entry> entries;
  for (Planned& planned : Plan(options)) entries.push_back(std::move(planned.entry));
  return entries;
}

absl::Status GenerateCheckpoint(const GeneratorOptions& options) {
  RS_RETURN_IF_ERROR(CheckOptions(options));
  const fs::path folder = absl::StrCat(options.out, ".tmp.", ::getpid());
  absl::Cleanup remove = [&] {
    std::error_code ignored;
    fs::remove_all(folder, ignored);
  };
  RS_RETURN_IF_ERROR(MakeDirectories(folder.string()));
  RS_RETURN_IF_ERROR(WriteWeights(options, folder));
  RS_RETURN_IF_ERROR(WriteSideFiles(options, ConfigOf(options), folder.string()));
  std::error_code error;
  fs::rename(folder, options.out, error);
  if (error) {
    return absl::UnavailableError(
        absl::StrCat("cannot publish '", options.out, "': ", error.message()));
  }
  return absl::OkStatus();
}

}  // namespace robostress::openpi
