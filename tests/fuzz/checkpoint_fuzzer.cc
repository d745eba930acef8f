// The readers of what lies beside a checkpoint's weights: index, config.json, norm_stats.json, and
// LeRobot's statistics in a safetensors file. Every input goes through all four.
#include <cmath>

#include "server/policies/openpi/checkpoint_config.h"
#include "server/policies/openpi/checkpoint_files.h"
#include "server/policies/openpi/norm_stats.h"
#include "tests/fuzz/fuzz_check.h"

namespace robostress::openpi {
namespace {

void CheckStats(const NormStats& stats) {
  FuzzCheck(!stats.fields.empty(), "statistics of nothing were accepted");
  for (const auto& [key, field] : stats.fields) {
    FuzzCheck(field.dims() > 0 && field.std.size() == field.dims(), "lengths differ");
    FuzzCheck(field.q01.size() == field.q99.size(), "half of the quantiles");
    FuzzCheck(!field.has_quantiles() || field.q01.size() == field.dims(), "lengths differ");
    for (size_t i = 0; i < field.dims(); ++i) {
      FuzzCheck(std::isfinite(field.mean[i]) && std::isfinite(field.std[i]) && field.std[i] >= 0,
                "an impossible statistic");
      FuzzCheck(!field.has_quantiles() || field.q01[i] <= field.q99[i], "crossed quantiles");
    }
  }
}

template <class T>
bool Accepted(const absl::StatusOr<T>& result, const std::string& file) {
  if (!result.ok()) CheckRefusal(result.status(), file);
  return result.ok();
}

}  // namespace
}  // namespace robostress::openpi

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  using namespace robostress;
  using namespace robostress::openpi;
  const std::string text(reinterpret_cast<const char*>(data), size);
  const std::string name = "input.file";
  if (const auto map = ParseShardIndex(name, text); Accepted(map, name)) {
    for (const auto& [tensor, shard] : *map)
      FuzzCheck(shard.find('/') == std::string::npos, "a shard outside of the folder");
  }
  if (const auto config = ParseCheckpointConfig(name, text); Accepted(config, name))
    FuzzCheck(config->horizon.value_or(1) >= 1, "an impossible horizon");
  if (const auto stats = ParseNormStats(name, text); Accepted(stats, name)) CheckStats(*stats);
  if (const auto file = SafetensorsFile::Parse(name, text); Accepted(file, name)) {
    if (const auto stats = NormStatsOf(*file); Accepted(stats, name)) CheckStats(*stats);
  }
  return 0;
}
