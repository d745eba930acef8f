#include "server/policies/openpi/generated_files.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/random.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress::openpi {
namespace {

using Json = nlohmann::ordered_json;

constexpr int kStateDims = 8, kActionDims = 7;
constexpr char kNormalizerFile[] = "policy_preprocessor_step_5_normalizer_processor.safetensors";

Json OpenpiJson(const GeneratorOptions& options, const OpenpiConfig& config) {
  Json json = {{"action_dim", config.action_dim},
               {"action_horizon", config.horizon},
               {"precision", options.dtype == DType::kF32 ? "float32" : "bfloat16"}};
  if (!options.full) return json;
  json["paligemma_variant"] = "gemma_2b";
  json["action_expert_variant"] = "gemma_300m";
  return json;
}

Json LerobotJson(const GeneratorOptions& options, const OpenpiConfig& config) {
  const bool old = options.layout == CheckpointLayout::kLerobotOld;
  const char* mode = config.pi05 ? "QUANTILES" : "MEAN_STD";
  Json features = Json::object();
  for (const char* camera : {"base_0_rgb", "left_wrist_0_rgb", "right_wrist_0_rgb"}) {
    features[absl::StrCat("observation.images.", camera)] = {
        {"type", "VISUAL"}, {"shape", {3, config.image, config.image}}};
  }
  features["observation.state"] = {{"type", "STATE"}, {"shape", {kStateDims}}};
  Json json = {
      {"type", config.pi05 ? "pi05" : "pi0"},
      {"n_obs_steps", 1},
      {"input_features", features},
      {"output_features", {{"action", {{"type", "ACTION"}, {"shape", {kActionDims}}}}}},
      {"chunk_size", config.horizon},
      {"n_action_steps", config.horizon},
      {"max_state_dim", config.action_dim},
      {"max_action_dim", config.action_dim},
      {"tokenizer_max_length", config.prompt_tokens},
      {"normalization_mapping", {{"VISUAL", "IDENTITY"}, {"STATE", mode}, {"ACTION", mode}}},
      {old ? "num_steps" : "num_inference_steps", 10},
      {old ? "resize_imgs_with_padding" : "image_resolution", {config.image, config.image}}};
  if (old || !options.full) return json;
  json["paligemma_variant"] = "gemma_2b";
  json["action_expert_variant"] = "gemma_300m";
  json["dtype"] = options.dtype == DType::kF32 ? "float32" : "bfloat16";
  return json;
}

absl::Status WriteJson(const std::string& path, const Json& json) {
  return WriteFileAtomically(path, json.dump(2) + "\n");
}

absl::Status WriteAssets(const NormStats& stats, const std::string& folder) {
  Json fields = Json::object();
  for (const auto& [key, field] : stats.fields) {
    fields[key] = {
        {"mean", field.mean}, {"std", field.std}, {"q01", field.q01}, {"q99", field.q99}};
  }
  const std::string assets = absl::StrCat(folder, "/assets/generated");
  RS_RETURN_IF_ERROR(MakeDirectories(assets));
  return WriteJson(absl::StrCat(assets, "/norm_stats.json"), {{"norm_stats", fields}});
}

absl::Status WriteNormalizer(const NormStats& stats, const std::string& folder) {
  SafetensorsWriter writer;
  for (const auto& [key, feature] :
       {std::pair{"state", "observation.state"}, std::pair{"actions", "action"}}) {
    const FieldStats& field = stats.fields.at(key);
    for (const auto& [name, values] :
         {std::pair{"mean", &field.mean}, std::pair{"std", &field.std},
          std::pair{"q01", &field.q01}, std::pair{"q99", &field.q99}}) {
      const std::vector<float> floats(values->begin(), values->end());
      writer.AddFloats(absl::StrCat(feature, ".", name), {static_cast<int64_t>(floats.size())},
                       floats);
    }
  }
  RS_RETURN_IF_ERROR(writer.Write(absl::StrCat(folder, "/", kNormalizerFile)));
  const Json step = {{"registry_name", "normalizer_processor"}, {"state_file", kNormalizerFile}};
  return WriteJson(absl::StrCat(folder, "/policy_preprocessor.json"),
                   {{"name", "policy_preprocessor"}, {"steps", {step}}});
}

}  // namespace

NormStats RandomNormStats(uint64_t seed) {
  RandomStream random(StreamKey("norm_stats").With(static_cast<int64_t>(seed)));
  NormStats stats;
  for (const auto& [key, dims] :
       {std::pair{"state", kStateDims}, std::pair{"actions", kActionDims}}) {
    FieldStats& field = stats.fields[key];
    for (int i = 0; i < dims; ++i) {
      // float32, so that all layouts hold the same numbers.
      const double mean = static_cast<float>(random.Uniform(-0.5, 0.5));
      const double std = static_cast<float>(random.Uniform(0.1, 1.0));
      field.mean.push_back(mean);
      field.std.push_back(std);
      field.q01.push_back(static_cast<float>(mean - 2 * std));
      field.q99.push_back(static_cast<float>(mean + 2 * std));
    }
  }
  return stats;
}

absl::Status WriteSideFiles(const GeneratorOptions& options, const OpenpiConfig& config,
                            const std::string& folder) {
  const bool openpi = options.layout == CheckpointLayout::kOpenpi;
  RS_RETURN_IF_ERROR(
      WriteJson(absl::StrCat(folder, "/config.json"),
                openpi ? OpenpiJson(options, config) : LerobotJson(options, config)));
  const NormStats stats = RandomNormStats(options.seed);
  if (openpi) return WriteAssets(stats, folder);
  if (options.layout == CheckpointLayout::kLerobot) return WriteNormalizer(stats, folder);
  return absl::OkStatus();
}

void AddStatisticsBuffers(uint64_t seed, std::vector<SafetensorsStream::Entry>& entries,
                          std::vector<float>& values) {
  const NormStats stats = RandomNormStats(seed);
  for (const auto& [buffer, key] : {std::pair{"normalize_inputs.buffer_observation_state", "state"},
                                    std::pair{"normalize_targets.buffer_action", "actions"},
                                    std::pair{"unnormalize_outputs.buffer_action", "actions"}}) {
    const FieldStats& field = stats.fields.at(key);
    for (const auto& [name, list] :
         {std::pair{"mean", &field.mean}, std::pair{"std", &field.std}}) {
      entries.push_back(
          {absl::StrCat(buffer, ".", name), DType::kF32, {static_cast<int64_t>(list->size())}});
      values.insert(values.end(), list->begin(), list->end());
    }
  }
}

std::string ShardName(int64_t shard, int64_t shards) {
  return absl::StrFormat("model-%05d-of-%05d.safetensors", shard, shards);
}

std::string IndexJson(const std::map<std::string, std::string>& weight_map, uint64_t total_bytes) {
  const Json json = {{"metadata", {{"total_size", total_bytes}}}, {"weight_map", weight_map}};
  return json.dump(2) + "\n";
}

}  // namespace robostress::openpi
