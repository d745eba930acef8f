#include "server/policies/openpi/checkpoint_sizes.h"

#include <cmath>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "server/policies/openpi/problem_list.h"

namespace robostress::openpi {
namespace {

constexpr char kVision[] = "paligemma_with_expert.paligemma.model.vision_tower.vision_model.";
constexpr char kPrefix[] = "paligemma_with_expert.paligemma.model.language_model.";
constexpr char kExpert[] = "paligemma_with_expert.gemma_expert.model.";

// openpi's Gemma configurations; LoRA variants have the same base.
struct GemmaVariant {
  const char* name;
  int64_t width, depth, mlp, heads, kv_heads, head_dim;
};
constexpr GemmaVariant kVariants[] = {{"gemma_2b", 2048, 18, 16384, 8, 1, 256},
                                      {"gemma_300m", 1024, 18, 4096, 8, 1, 256},
                                      {"dummy", 64, 4, 128, 8, 1, 16}};

// SigLIP So400m/14, the only image encoder that openpi and LeRobot build.
constexpr int64_t kSiglipWidth = 1152, kSiglipDepth = 27, kSiglipHeads = 16, kSiglipMlp = 4304,
                  kSiglipPatch = 14, kSiglipImage = 224;

constexpr int64_t kPi0PromptTokens = 48, kPi05PromptTokens = 200;  // openpi's max_token_len

const GemmaVariant* FindVariant(const std::string& name) {
  for (const GemmaVariant& variant : kVariants) {
    if (name == variant.name || name == absl::StrCat(variant.name, "_lora")) return &variant;
  }
  return nullptr;
}

// Where a size can be read: extent `dim` of the tensors below `root` that end in `suffix`.
struct Evidence {
  const char* root;
  const char* suffix;
  size_t dim;
};

// The extent that most tensors show; 0 without any.
int64_t CommonExtent(const std::map<std::string, StoredTensor>& tensors,
                     const std::vector<Evidence>& evidence) {
  std::map<int64_t, int> votes;
  for (const auto& [name, stored] : tensors) {
    for (const Evidence& e : evidence) {
      if (absl::StartsWith(name, e.root) && absl::EndsWith(name, e.suffix) &&
          stored.view.shape.size() > e.dim) {
        ++votes[stored.view.shape[e.dim]];
      }
    }
  }
  int64_t common = 0;
  int most = 0;
  for (const auto& [extent, count] : votes) {
    if (count > most) common = extent, most = count;
  }
  return common;
}

// One expert's variant: named by config.json, else recognised by its width and MLP; the published
// one where there is no evidence at all, so that the list of missing tensors is complete.
const GemmaVariant* VariantOf(const SizeSources& sources, const char* role, const char* root,
                              const std::string& declared, const char* published,
                              std::vector<std::string>& problems, std::vector<std::string>& notes) {
  if (!declared.empty()) {
    const GemmaVariant* variant = FindVariant(declared);
    if (variant == nullptr) {
      problems.push_back(absl::StrCat(role, " '", declared, "' of ", sources.declared.file,
                                      " is not known, must be gemma_2b, gemma_300m or dummy"));
    }
    return variant;
  }
  const int64_t width = CommonExtent(
      sources.tensors, {{root, "self_attn.q_proj.weight", 1}, {root, "mlp.gate_proj.weight", 1}});
  const int64_t mlp = CommonExtent(sources.tensors, {{root, "mlp.gate_proj.weight", 0}});
  if (width == 0 && mlp == 0) return FindVariant(published);
  for (const GemmaVariant& variant : kVariants) {
    if (variant.width != width || variant.mlp != mlp) continue;
    notes.push_back(absl::StrCat(role, " ", variant.name, ", recognised by width ", width,
                                 " and mlp ", mlp, ": no file names it"));
    return &variant;
  }
  problems.push_back(absl::StrCat("heads and head_dim of ", role, ": width ", width, ", mlp ", mlp,
                                  " is no known variant"));
  return nullptr;
}

void DeriveVision(const SizeSources& sources, OpenpiConfig& c, std::vector<std::string>& problems) {
  const auto& tensors = sources.tensors;
  const int64_t width = CommonExtent(
      tensors, {{kVision, "layer_norm1.weight", 0}, {kVision, "patch_embedding.weight", 0}});
  if (width != 0 && width != kSiglipWidth) {
    problems.push_back(absl::StrCat("heads of the image encoder: its width is ", width, ", only ",
                                    kSiglipWidth, " (So400m/14) is known"));
    return;
  }
  c.vision_width = kSiglipWidth, c.vision_depth = kSiglipDepth, c.vision_heads = kSiglipHeads;
  c.vision_mlp = kSiglipMlp, c.patch = kSiglipPatch, c.image = kSiglipImage;
  const int64_t patches = CommonExtent(tensors, {{kVision, "position_embedding.weight", 0}});
  const int64_t side = std::llround(std::sqrt(static_cast<double>(patches)));
  if (side > 0 && side * side == patches && side <= 256) c.image = side * kSiglipPatch;
}

void DeriveExperts(const SizeSources& sources, OpenpiConfig& c, std::vector<std::string>& problems,
                   std::vector<std::string>& notes) {
  const GemmaVariant* prefix =
      VariantOf(sources, "paligemma_variant", kPrefix, sources.declared.paligemma_variant,
                "gemma_2b", problems, notes);
  const GemmaVariant* expert =
      VariantOf(sources, "action_expert_variant", kExpert, sources.declared.action_expert_variant,
                "gemma_300m", problems, notes);
  if (prefix == nullptr || expert == nullptr) return;
  if (prefix->depth != expert->depth || prefix->heads != expert->heads ||
      prefix->kv_heads != expert->kv_heads || prefix->head_dim != expert->head_dim) {
    problems.push_back(absl::StrCat(prefix->name, " and ", expert->name,
                                    " cannot share attention: depth or heads differ"));
    return;
  }
  c.prefix_width = prefix->width, c.prefix_mlp = prefix->mlp;
  c.expert_width = expert->width, c.expert_mlp = expert->mlp;
  c.depth = prefix->depth, c.heads = prefix->heads;
  c.kv_heads = prefix->kv_heads, c.head_dim = prefix->head_dim;
}

// The rest: what tensors show, what config.json or the caller says, openpi's defaults.
void DeriveInputs(const SizeSources& sources, OpenpiConfig& c, std::vector<std::string>& problems,
                  std::vector<std::string>& notes) {
  const CheckpointConfig& declared = sources.declared;
  const CheckpointOptions& options = sources.options;
  c.vocab =
      CommonExtent(sources.tensors, {{kPrefix, "embed_tokens.weight", 0},
                                     {"paligemma_with_expert.paligemma.lm_head.weight", "", 0}});
  if (c.vocab == 0) c.vocab = 257152;  // PaliGemma's; the tensor will be listed as missing
  c.action_dim = CommonExtent(sources.tensors, {{"action_in_proj.weight", "", 1},
                                                {"action_out_proj.weight", "", 0},
                                                {"action_out_proj.bias", "", 0}});
  if (c.action_dim == 0) c.action_dim = declared.action_dim.value_or(32);
  c.horizon = options.horizon.value_or(declared.horizon.value_or(0));
  if (c.horizon == 0) {
    problems.push_back(
        "horizon: no tensor shows it and no config.json says action_horizon or chunk_size; state "
        "it (openpi: 50 for base models, 10 for LIBERO's)");
  }
  c.prompt_tokens = options.prompt_tokens.value_or(declared.prompt_tokens.value_or(0));
  if (c.prompt_tokens == 0) {
    c.prompt_tokens = c.pi05 ? kPi05PromptTokens : kPi0PromptTokens;
    notes.push_back(absl::StrCat("prompt_tokens ", c.prompt_tokens, ", openpi's for ", c.name(),
                                 ": no file says it"));
  }
  c.state_dim = declared.robot_state_dim.value_or(0);
}

}  // namespace

absl::StatusOr<bool> DetectPi05(const SizeSources& sources) {
  int plain = 0, adaptive = 0;
  std::string plain_name, adaptive_name;
  for (const auto& [name, stored] : sources.tensors) {
    if (!absl::StartsWith(name, kExpert)) continue;
    if (absl::EndsWith(name, "norm.dense.weight")) ++adaptive, adaptive_name = name;
    if (absl::EndsWith(name, "norm.weight")) ++plain, plain_name = name;
  }
  if (plain == adaptive) {
    if (plain > 0) {
      return absl::InvalidArgumentError(absl::StrCat(
          sources.path, ": is it pi0 or pi0.5? It holds as many plain norms of the action expert (",
          plain_name, ") as adaptive ones (", adaptive_name,
          "); take a checkpoint as its converter wrote it"));
    }
    return sources.declared.pi05.value_or(!sources.tensors.contains("state_proj.weight"));
  }
  const bool pi05 = adaptive > plain;
  if (sources.declared.pi05.value_or(pi05) != pi05) {
    return absl::InvalidArgumentError(absl::StrCat(
        sources.declared.file, ": type is ", pi05 ? "pi0" : "pi05",
        ", but the tensors are those of ", pi05 ? "pi0.5" : "pi0", " (",
        pi05 ? adaptive_name : plain_name, "); take the config.json that was written with them"));
  }
  return pi05;
}

absl::StatusOr<OpenpiConfig> DeriveSizes(const SizeSources& sources, bool pi05,
                                         std::vector<std::string>& notes) {
  OpenpiConfig config;
  config.pi05 = pi05;
  std::vector<std::string> problems;
  DeriveVision(sources, config, problems);
  DeriveExperts(sources, config, problems, notes);
  DeriveInputs(sources, config, problems, notes);
  const std::string config_file =
      sources.declared.file.empty() ? "no config.json beside it" : sources.declared.file;
  RS_RETURN_IF_ERROR(ProblemList(
      sources.path,
      absl::StrCat("no file says all sizes of the network (metadata has no 'config'; ", config_file,
                   ")"),
      problems,
      "Add the config.json that its converter writes, with the fields named above, or put all "
      "sizes into the metadata under 'config'"));
  RS_RETURN_IF_ERROR(CheckOpenpiConfig(sources.path, config));
  return config;
}

absl::Status CheckDeclared(const SizeSources& sources, const OpenpiConfig& c) {
  const CheckpointConfig& declared = sources.declared;
  std::vector<std::string> problems;
  const auto compare = [&](const std::string& what, const std::optional<int64_t>& said,
                           int64_t value) {
    if (said && *said != value)
      problems.push_back(absl::StrCat(what, " is ", *said, ", the checkpoint has ", value));
  };
  const auto compare_variant = [&](const std::string& what, const std::string& name, int64_t width,
                                   int64_t mlp) {
    const GemmaVariant* variant = FindVariant(name);
    if (variant == nullptr) return;
    compare(absl::StrCat("width of ", what, " ", name), variant->width, width);
    compare(absl::StrCat("mlp of ", what, " ", name), variant->mlp, mlp);
    compare(absl::StrCat("depth of ", what, " ", name), variant->depth, c.depth);
  };
  if (declared.pi05 && *declared.pi05 != c.pi05) {
    problems.push_back(absl::StrCat("type is ", *declared.pi05 ? "pi05" : "pi0",
                                    ", the checkpoint is ", c.name()));
  }
  compare_variant("paligemma_variant", declared.paligemma_variant, c.prefix_width, c.prefix_mlp);
  compare_variant("action_expert_variant", declared.action_expert_variant, c.expert_width,
                  c.expert_mlp);
  compare("action_dim or max_action_dim", declared.action_dim, c.action_dim);
  compare("max_state_dim", declared.state_dim, c.action_dim);
  compare("action_horizon or chunk_size", declared.horizon, c.horizon);
  compare("tokenizer_max_length", declared.prompt_tokens, c.prompt_tokens);
  compare("image size", declared.image, c.image);
  for (const auto& [what, dim] : {std::pair{"observation.state", declared.robot_state_dim},
                                  std::pair{"action", declared.robot_action_dim}}) {
    if (dim.value_or(0) > c.action_dim) {
      problems.push_back(absl::StrCat("shape of ", what, " is ", *dim,
                                      ", the network has room for ", c.action_dim));
    }
  }
  compare("the stated horizon", sources.options.horizon, c.horizon);
  compare("the stated prompt_tokens", sources.options.prompt_tokens, c.prompt_tokens);
  return ProblemList(declared.file.empty() ? sources.path : declared.file,
                     "contradicts the rest of the checkpoint", problems,
                     "Take the files that were written together; leave out options that files "
                     "already answer");
}

}  // namespace robostress::openpi
