#include "server/policies/openpi/openpi_config.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress::openpi {
namespace {

struct ConfigField {
  const char* key;
  int64_t OpenpiConfig::*member;
  int64_t max;
};

// Each limit is several times what any published checkpoint has.
constexpr ConfigField kConfigFields[] = {
    {"image", &OpenpiConfig::image, 4096},        {"patch", &OpenpiConfig::patch, 4096},
    {"vw", &OpenpiConfig::vision_width, 1 << 16}, {"vd", &OpenpiConfig::vision_depth, 512},
    {"vh", &OpenpiConfig::vision_heads, 1024},    {"vm", &OpenpiConfig::vision_mlp, 1 << 18},
    {"pw", &OpenpiConfig::prefix_width, 1 << 16}, {"pm", &OpenpiConfig::prefix_mlp, 1 << 18},
    {"ew", &OpenpiConfig::expert_width, 1 << 16}, {"em", &OpenpiConfig::expert_mlp, 1 << 18},
    {"depth", &OpenpiConfig::depth, 512},         {"heads", &OpenpiConfig::heads, 1024},
    {"kv_heads", &OpenpiConfig::kv_heads, 1024},  {"hd", &OpenpiConfig::head_dim, 4096},
    {"vocab", &OpenpiConfig::vocab, 1 << 24},     {"horizon", &OpenpiConfig::horizon, 4096},
    {"adim", &OpenpiConfig::action_dim, 4096},    {"tlen", &OpenpiConfig::prompt_tokens, 1 << 16},
};

constexpr char kRemedy[] =
    "; the metadata must hold the sizes of the network as JSON under 'config': take the file as "
    "its "
    "converter wrote it";

// Reads one size; a description of the problem, or empty.
std::string ReadSize(const nlohmann::json& json, const ConfigField& field, OpenpiConfig& config) {
  const auto found = json.find(field.key);
  if (found == json.end()) return absl::StrCat(field.key, " is missing");
  if (!found->is_number_integer() || *found < 1 || *found > field.max) {
    return absl::StrCat(field.key, " is ", found->dump(), ", must be an integer in 1..", field.max);
  }
  config.*field.member = found->get<int64_t>();
  return "";
}

// Relations between sizes that the formulas need.
std::vector<std::string> Contradictions(const OpenpiConfig& c) {
  std::vector<std::string> problems;
  if (c.patch > c.image)
    problems.push_back(absl::StrCat("patch ", c.patch, " exceeds image ", c.image));
  if (c.vision_width % c.vision_heads != 0) {
    problems.push_back(
        absl::StrCat("vw ", c.vision_width, " is no multiple of vh ", c.vision_heads));
  }
  if (c.heads % c.kv_heads != 0)
    problems.push_back(absl::StrCat("heads ", c.heads, " is no multiple of kv_heads ", c.kv_heads));
  if (c.head_dim % 2 != 0)
    problems.push_back(absl::StrCat("hd ", c.head_dim, " is odd, rotation pairs need an even one"));
  if (c.expert_width % 2 != 0 || c.expert_width < 4) {
    problems.push_back(
        absl::StrCat("ew ", c.expert_width, " must be even and at least 4 for the time embedding"));
  }
  if (c.state_dim > c.action_dim)
    problems.push_back(absl::StrCat("sdim ", c.state_dim, " exceeds adim ", c.action_dim));
  return problems;
}

}  // namespace

absl::StatusOr<OpenpiConfig> ParseOpenpiConfig(const std::string& file, const std::string& text) {
  const nlohmann::json json = nlohmann::json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": metadata 'config' is not a JSON object", kRemedy));
  }
  OpenpiConfig config;
  std::vector<std::string> problems;
  for (const ConfigField& field : kConfigFields) {
    if (std::string problem = ReadSize(json, field, config); !problem.empty())
      problems.push_back(std::move(problem));
  }
  if (const auto pi05 = json.find("pi05"); pi05 != json.end() && pi05->is_boolean()) {
    config.pi05 = pi05->get<bool>();
  } else {
    problems.push_back("pi05 must be true or false");
  }
  if (json.contains("sdim")) {
    constexpr ConfigField kStateDim = {"sdim", &OpenpiConfig::state_dim, 4096};
    if (std::string problem = ReadSize(json, kStateDim, config); !problem.empty())
      problems.push_back(std::move(problem));
  }
  if (problems.empty()) problems = Contradictions(config);
  if (!problems.empty()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file, ": metadata 'config': ", absl::StrJoin(problems, ", "), kRemedy));
  }
  return config;
}

absl::StatusOr<OpenpiConfig> OpenpiConfigOf(const SafetensorsFile& file) {
  const auto found = file.metadata().find("config");
  if (found == file.metadata().end()) {
    return absl::InvalidArgumentError(
        absl::StrCat(file.path(), ": metadata has no 'config'", kRemedy));
  }
  return ParseOpenpiConfig(file.path(), found->second);
}

std::string OpenpiConfigJson(const OpenpiConfig& config) {
  nlohmann::json json = {{"pi05", config.pi05}};
  for (const ConfigField& field : kConfigFields) json[field.key] = config.*field.member;
  if (config.state_dim > 0) json["sdim"] = config.state_dim;
  return json.dump();
}

absl::Status CheckOpenpiConfig(const std::string& where, const OpenpiConfig& config) {
  std::vector<std::string> problems;
  for (const ConfigField& field : kConfigFields) {
    const int64_t value = config.*field.member;
    if (value < 1 || value > field.max)
      problems.push_back(absl::StrCat(field.key, " is ", value, ", must be in 1..", field.max));
  }
  if (problems.empty()) problems = Contradictions(config);
  if (problems.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(
      absl::StrCat(where, ": impossible sizes: ", absl::StrJoin(problems, ", ")));
}

absl::Status CheckSameConfig(const std::string& file, const OpenpiConfig& config,
                             const std::string& other_file, const OpenpiConfig& other) {
  std::vector<std::string> differences;
  if (config.pi05 != other.pi05)
    differences.push_back(absl::StrCat("model ", other.name(), " instead of ", config.name()));
  for (const ConfigField& field : kConfigFields) {
    const int64_t expected = config.*field.member, actual = other.*field.member;
    if (actual != expected)
      differences.push_back(absl::StrCat(field.key, " ", actual, " instead of ", expected));
  }
  if (differences.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(other_file, ": was made for another network than ",
                                                 file, ": ", absl::StrJoin(differences, ", "),
                                                 "; give files of the same case"));
}

}  // namespace robostress::openpi
