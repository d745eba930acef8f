#include "server/policies/openpi/checkpoint_layout.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/strip.h"
#include "server/policies/openpi/norm_stats.h"

namespace robostress::openpi {
namespace {

constexpr char kModel[] = "model.";

// What may follow a leading `model.`; anything else is a foreign name and keeps it.
constexpr const char* kRoots[] = {"paligemma_with_expert.", "action_in_proj.",
                                  "action_out_proj.",       "state_proj.",
                                  "action_time_mlp_",       "time_mlp_"};

// Where the old LeRobot generation and openpi put the same module.
struct Moved {
  const char* old_prefix;
  const char* prefix;
};
constexpr Moved kMoved[] = {
    {"paligemma_with_expert.paligemma.language_model.model.",
     "paligemma_with_expert.paligemma.model.language_model."},
    {"paligemma_with_expert.paligemma.language_model.lm_head.",
     "paligemma_with_expert.paligemma.lm_head."},
    {"paligemma_with_expert.paligemma.vision_tower.",
     "paligemma_with_expert.paligemma.model.vision_tower."},
    {"paligemma_with_expert.paligemma.multi_modal_projector.",
     "paligemma_with_expert.paligemma.model.multi_modal_projector."},
};

bool HasRoot(absl::string_view name) {
  for (const char* root : kRoots) {
    if (absl::StartsWith(name, root)) return true;
  }
  return false;
}

bool StripModel(absl::string_view& name) {
  absl::string_view rest = name;
  if (!absl::ConsumePrefix(&rest, kModel) || !HasRoot(rest)) return false;
  name = rest;
  return true;
}

}  // namespace

const char* LayoutName(CheckpointLayout layout) {
  switch (layout) {
    case CheckpointLayout::kOpenpi:
      return "openpi";
    case CheckpointLayout::kLerobot:
      return "lerobot";
    case CheckpointLayout::kLerobotOld:
      return "lerobot_old";
  }
  return "";
}

OpenpiName ToOpenpiName(const std::string& stored) {
  absl::string_view name = stored;
  const bool stripped = StripModel(name);
  for (const Moved& moved : kMoved) {
    absl::string_view rest = name;
    if (absl::ConsumePrefix(&rest, moved.old_prefix))
      return {absl::StrCat(moved.prefix, rest), CheckpointLayout::kLerobotOld};
  }
  return {std::string(name), stripped ? CheckpointLayout::kLerobot : CheckpointLayout::kOpenpi};
}

bool IsNetworkName(const std::string& name) { return HasRoot(name); }

std::string ToStoredName(const std::string& name, CheckpointLayout layout) {
  if (layout == CheckpointLayout::kOpenpi) return name;
  for (const Moved& moved : kMoved) {
    absl::string_view rest = name;
    if (layout == CheckpointLayout::kLerobotOld && absl::ConsumePrefix(&rest, moved.prefix))
      return absl::StrCat(kModel, moved.old_prefix, rest);
  }
  return absl::StrCat(kModel, name);
}

std::string TimeMlpName(const std::string& name, bool pi05) {
  absl::string_view rest = name;
  if (pi05 && absl::ConsumePrefix(&rest, "action_time_mlp_"))
    return absl::StrCat("time_mlp_", rest);
  if (!pi05 && absl::ConsumePrefix(&rest, "time_mlp_"))
    return absl::StrCat("action_time_mlp_", rest);
  return name;
}

bool IsUnusedTensor(const std::string& name, bool skip_state) {
  return name == "paligemma_with_expert.gemma_expert.lm_head.weight" || IsStatisticsBuffer(name) ||
         absl::EndsWith(name, ".position_ids") || absl::EndsWith(name, ".rotary_emb.inv_freq") ||
         (skip_state && absl::StartsWith(name, "state_proj."));
}

}  // namespace robostress::openpi
