#include "absl/strings/str_cat.h"
#include "server/policies/checkpoint_policies.h"
#include "server/policies/openpi/openpi_weights.h"
#include "server/policies/openpi/policy_setup.h"
#include "server/policies/openpi/precision.h"
#include "server/policies/openpi/tokenizer.h"

namespace robostress {
namespace {

using nlohmann::ordered_json;
using openpi::Checkpoint;
using openpi::OpenpiConfig;
using openpi::PolicySetup;

constexpr double kMiB = 1 << 20;

std::string Mebibytes(uint64_t bytes) {
  return absl::StrCat(bytes, " (", std::llround(static_cast<double>(bytes) / kMiB), " MiB)");
}

ordered_json Sizes(const OpenpiConfig& c) {
  return {{"image_px", c.image},
          {"patch_px", c.patch},
          {"vision_width", c.vision_width},
          {"vision_depth", c.vision_depth},
          {"vision_heads", c.vision_heads},
          {"vision_mlp", c.vision_mlp},
          {"prefix_width", c.prefix_width},
          {"prefix_mlp", c.prefix_mlp},
          {"expert_width", c.expert_width},
          {"expert_mlp", c.expert_mlp},
          {"depth", c.depth},
          {"heads", c.heads},
          {"kv_heads", c.kv_heads},
          {"head_dim", c.head_dim},
          {"vocabulary", c.vocab},
          {"action_dim", c.action_dim}};
}

const char* KindName(openpi::NormStatsSource::Kind kind) {
  switch (kind) {
    case openpi::NormStatsSource::Kind::kOpenpiJson:
      return "norm_stats.json";
    case openpi::NormStatsSource::Kind::kLerobotNormalizer:
      return "LeRobot's normalizer";
    case openpi::NormStatsSource::Kind::kLerobotBuffers:
      return "buffers in the weights";
  }
  return "?";
}

ordered_json DescribeCheckpoint(const Checkpoint& checkpoint) {
  int64_t parameters = 0;
  for (const auto& [name, tensor] : checkpoint.tensors) parameters += tensor.view.num_elements();
  ordered_json is = {{"network", checkpoint.config.name()},
                     {"layout", LayoutName(checkpoint.layout)},
                     {"parameters", parameters},
                     {"bytes", Mebibytes(checkpoint.tensor_bytes())},
                     {"file_bytes", Mebibytes(checkpoint.file_bytes())},
                     {"stored_as", checkpoint.stored_precision()}};
  for (const auto& shard : checkpoint.shards) is["shards"].push_back(shard->path());
  if (const auto found = checkpoint.tensors.find(openpi::kEmbeddingName);
      found != checkpoint.tensors.end()) {
    is["embedding_stored_as"] = found->second.stored_name;
  }
  is["unused_tensors"] = checkpoint.unused;
  is["config_json"] = checkpoint.declared.file.empty() ? "none" : checkpoint.declared.file;
  is["norm_stats"] = ordered_json::array();
  for (const openpi::NormStatsSource& source : checkpoint.norm_stats) {
    is["norm_stats"].push_back(absl::StrCat(
        source.file, " (", KindName(source.kind),
        source.asset_id.empty() ? "" : absl::StrCat(", asset_id ", source.asset_id), ")"));
  }
  is["sizes"] = Sizes(checkpoint.config);
  return is;
}

std::string PromptFormatText(const PolicySetup& setup, int64_t action_dim) {
  if (setup.prompt == openpi::PromptFormat::kText) return "BOS, text, newline";
  const int64_t bins = setup.prompt_has_padded_state ? action_dim : setup.robot.state_dim;
  return absl::StrCat("BOS, \"Task: TEXT, State: B1 .. B", bins, ";\\nAction: \"");
}

std::string DeltaText(const PolicySetup& setup) {
  if (!setup.delta) return "absolute, as the network gives them";
  return absl::StrCat("delta: entries 0..", setup.robot.delta_dims - 1,
                      " are relative to the state at the chunk's start");
}

ordered_json DescribeSetup(const PolicySetup& setup, const OpenpiConfig& config) {
  const auto norm = [&](const openpi::Normaliser& normaliser) {
    return absl::StrCat(NormKindName(normaliser.kind()), " (", NormConventionName(setup.convention),
                        ")");
  };
  ordered_json cameras;
  for (size_t i = 0; i < openpi::kImageSlots.size(); ++i) {
    const std::string& camera = setup.robot.cameras[i];
    cameras[openpi::kImageSlots[i]] = camera.empty() ? "absent, masked" : camera;
  }
  return {{"transform", setup.robot.name},
          {"meaning", setup.robot.meaning},
          {"cameras", cameras},
          {"image", absl::StrCat(config.image, " x ", config.image, " px RGB")},
          {"resize", setup.resize == openpi::ResizeFilter::kPillow
                         ? "keeps aspect, black padding, Pillow's bilinear"
                         : "keeps aspect, black padding, torch's bilinear"},
          {"prompt", PromptFormatText(setup, config.action_dim)},
          {"prompt_tokens", setup.prompt_tokens},
          {"state_dim", setup.robot.state_dim},
          {"state_normalisation", norm(setup.state)},
          {"state_enters", config.pi05 ? setup.prompt == openpi::PromptFormat::kTextAndState
                                             ? "in the prompt, as bins"
                                             : "nowhere"
                                       : "as a token"},
          {"action_dim", setup.robot.action_dim},
          {"action_normalisation", norm(setup.actions)},
          {"actions", DeltaText(setup)},
          {"horizon", config.horizon},
          {"execute_steps", setup.execute_steps},
          {"euler_steps", setup.euler_steps},
          {"norm_stats", setup.stats.source.empty() ? "none" : setup.stats.source}};
}

// The tokenizer, and whether it fits; it is looked at even where the checkpoint cannot be opened.
void InspectTokenizer(const std::string& path, const OpenpiConfig* config,
                      PolicyInspection& inspection) {
  const auto tokenizer = openpi::Tokenizer::Load(path);
  if (!tokenizer.ok()) {
    inspection.problems.emplace_back(tokenizer.status().message());
    return;
  }
  inspection.content["is"]["tokenizer"] = {
      {"file", path}, {"pieces", (*tokenizer)->pieces()}, {"bos", (*tokenizer)->bos()}};
  if (config == nullptr) return;
  const absl::Status fits = CheckPieces(**tokenizer, config->vocab);
  if (!fits.ok()) inspection.problems.emplace_back(fits.message());
  if (fits.ok() && (*tokenizer)->pieces() != config->vocab) {
    inspection.notes.push_back(absl::StrCat("the tokenizer has ", (*tokenizer)->pieces(),
                                            " pieces, the embedding ", config->vocab,
                                            " rows: is it the one of the training?"));
  }
}

}  // namespace

void InspectCheckpoint(const std::string& path, const std::vector<std::string>& overrides,
                       PolicyInspection& inspection) {
  absl::StatusOr<openpi::PolicyOptions> options = openpi::ReadPolicyOptions(path, overrides);
  if (!options.ok()) {
    inspection.problems.emplace_back(options.status().message());
    options.emplace();  // what can be said without them
  }
  const absl::StatusOr<Checkpoint> checkpoint =
      openpi::OpenCheckpoint(path, NetworkOptions(*options));
  if (!checkpoint.ok()) {
    inspection.problems.emplace_back(checkpoint.status().message());
    const auto tokenizer =
        openpi::FindTokenizer(options->tokenizer, openpi::CheckpointFolder(path));
    if (tokenizer.ok()) return InspectTokenizer(*tokenizer, nullptr, inspection);
    inspection.problems.emplace_back(tokenizer.status().message());
    return;
  }
  inspection.notes = checkpoint->notes;
  inspection.content["is"] = DescribeCheckpoint(*checkpoint);
  const openpi::SetupResult resolved = ResolveSetup(*checkpoint, *options);
  inspection.problems.insert(inspection.problems.end(), resolved.problems.begin(),
                             resolved.problems.end());
  if (const absl::Status device = openpi::FindDevice(options->device).status(); !device.ok())
    inspection.problems.emplace_back(device.message());
  if (!resolved.setup.tokenizer.empty())
    InspectTokenizer(resolved.setup.tokenizer, &checkpoint->config, inspection);
  inspection.content["expects"] = DescribeSetup(resolved.setup, checkpoint->config);
  inspection.content["computes"] = {
      {"precision", options->precision == openpi::PrecisionSetting::kBf16 ? "bf16" : "float32"},
      {"device", options->device},
      {"threads", options->threads}};
}

}  // namespace robostress
