#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "tests/server/policies/tiny_openpi.h"
#include "tests/server/policies/tiny_tokenizer.h"

// A checkpoint folder of a tiny network as openpi's converter leaves it, with assets and tokenizer.
namespace robostress::openpi {

// A network that the tiny tokenizer and LIBERO's states fit.
inline OpenpiConfig TinyServedConfig(bool pi05) {
  OpenpiConfig c = TinyConfig(pi05);
  c.vocab = 400, c.prompt_tokens = pi05 ? 60 : 14, c.state_dim = 8;
  return c;
}

// Statistics of `dims` entries that differ by entry.
inline FieldStats TinyStats(int64_t dims, double shift) {
  FieldStats stats;
  for (int64_t i = 0; i < dims; ++i) {
    const double x = static_cast<double>(i);
    stats.mean.push_back(0.1 * x + shift);
    stats.std.push_back(0.5 + 0.1 * x);
    stats.q01.push_back(-1 - 0.1 * x + shift);
    stats.q99.push_back(1 + 0.2 * x + shift);
  }
  return stats;
}

inline std::string StatsJson(const FieldStats& s) {
  return absl::StrCat("{\"mean\": [", absl::StrJoin(s.mean, ", "), "], \"std\": [",
                      absl::StrJoin(s.std, ", "), "], \"q01\": [", absl::StrJoin(s.q01, ", "),
                      "], \"q99\": [", absl::StrJoin(s.q99, ", "), "]}");
}

inline void WriteText(const std::filesystem::path& path, const std::string& text) {
  std::filesystem::create_directories(path.parent_path());
  std::ofstream(path) << text;
}

inline constexpr char kTinyAsset[] = "assets/physical-intelligence/libero/norm_stats.json";

// Writes the folder NAME anew and returns its path.
inline std::filesystem::path WriteTinyCheckpoint(const std::string& name, bool pi05) {
  const auto folder = std::filesystem::path(::testing::TempDir()) / name;
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  const OpenpiModel model = RandomOpenpiModel(TinyServedConfig(pi05), 5);
  WriteTensors(name + "/model.safetensors", WeightTensors(model),
               {{"config", ConfigJson(model.config)}});
  WriteText(folder / kTinyAsset,
            absl::StrCat("{\"norm_stats\": {\"state\": ", StatsJson(TinyStats(8, 0)),
                         ", \"actions\": ", StatsJson(TinyStats(7, 0.3)), "}}"));
  std::filesystem::copy_file(kTinyTokenizer, folder / "tokenizer.model");
  return folder;
}

}  // namespace robostress::openpi
