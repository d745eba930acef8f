#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::openpi {

enum class Setting { kAuto, kYes, kNo };
enum class NormSetting { kAuto, kNone, kZScore, kQuantile };
enum class ResizeSetting { kAuto, kPillow, kInterpolate };
enum class PrecisionSetting { kFloat32, kBf16 };

// What a checkpoint does not say of itself. From robostress_policy.yaml beside it and from
// `--policy-options KEY=VALUE ...`, which win. "auto" is resolved in policy_setup.h.
struct PolicyOptions {
  std::string name;
  std::string transform = "auto";
  std::string tokenizer;
  std::string norm_stats;
  std::string asset_id;
  NormSetting normalisation = NormSetting::kAuto;
  Setting delta = Setting::kAuto;
  Setting discrete_state = Setting::kAuto;
  ResizeSetting resize = ResizeSetting::kAuto;
  int64_t horizon = 0;
  int64_t execute_steps = 0;
  int64_t prompt_tokens = 0;
  int64_t euler_steps = 0;
  std::vector<std::string> cameras;
  PrecisionSetting precision = PrecisionSetting::kFloat32;
  std::string device = "cpu";
  int64_t threads = 1;

  template <class V>
  void Visit(V& v) {
    v.Field("name", name, "that sessions ask for; empty: the path as given");
    v.Field("transform", transform,
            "auto, plain, libero or piper; auto: libero where the asset id says so, else plain");
    v.Field("tokenizer", tokenizer,
            "SentencePiece model; empty: ROBOSTRESS_TOKENIZER, else beside "
            "the checkpoint");
    v.Field("norm_stats", norm_stats, "norm_stats.json; empty: what the checkpoint holds");
    v.Field("asset_id", asset_id, "which of several norm stats, e.g. physical-intelligence/libero");
    v.Choice("normalisation", normalisation,
             {{"auto", NormSetting::kAuto},
              {"none", NormSetting::kNone},
              {"z_score", NormSetting::kZScore},
              {"quantile", NormSetting::kQuantile}},
             "auto: config.json, else z_score for pi0 and quantile for pi0.5");
    v.Choice("delta", delta, Settings(),
             "actions are relative to the state at the chunk's start; auto: the transform's");
    v.Choice("discrete_state", discrete_state, Settings(),
             "pi0.5: the state stands in the prompt; auto: the transform's, for LeRobot yes");
    v.Choice("resize", resize,
             {{"auto", ResizeSetting::kAuto},
              {"pillow", ResizeSetting::kPillow},
              {"interpolate", ResizeSetting::kInterpolate}},
             "of images that are not of the network's size; auto: interpolate for LeRobot");
    v.Field("horizon", horizon, "actions per chunk; 0: the checkpoint's");
    v.Field("execute_steps", execute_steps, "of a chunk before the next prediction; 0: 5");
    v.Field("prompt_tokens", prompt_tokens, "length of a prompt; 0: the checkpoint's");
    v.Field("euler_steps", euler_steps, "steps from noise to actions; 0: the checkpoint's, or 10");
    v.Field("cameras", cameras,
            "the environment's cameras for base, left wrist, right wrist, '' where absent; empty: "
            "the transform's");
    v.Choice("precision", precision,
             {{"float32", PrecisionSetting::kFloat32}, {"bf16", PrecisionSetting::kBf16}},
             "of the large matrices and of stored prefixes; bf16 takes half the memory");
    v.Field("device", device, "cpu, cuda or cuda:N; cuda needs a LibTorch that was built with it");
    v.Field("threads", threads,
            "within one prediction on the CPU, beside those of `robostress serve --threads`");
  }

 private:
  static std::vector<std::pair<const char*, Setting>> Settings() {
    return {{"auto", Setting::kAuto}, {"true", Setting::kYes}, {"false", Setting::kNo}};
  }
};

inline constexpr char kPolicyOptionsFile[] = "robostress_policy.yaml";

// The folder of a checkpoint: `path` itself or the folder of the file that it names.
std::string CheckpointFolder(const std::string& path);

// Reads the options of a checkpoint; unknown keys, wrong types and ranges are errors with file and
// key.
absl::StatusOr<PolicyOptions> ReadPolicyOptions(const std::string& path,
                                                const std::vector<std::string>& overrides);

}  // namespace robostress::openpi
