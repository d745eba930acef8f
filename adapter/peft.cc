#include "adapter/peft.h"

#include <torch/types.h>

#include <cmath>
#include <set>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using Json = nlohmann::ordered_json;

constexpr char kRoot[] = "base_model.model.";
constexpr char kA[] = ".lora_A.weight", kB[] = ".lora_B.weight";
constexpr int64_t kMaxRank = 1 << 16;

void AddMatrix(SafetensorsWriter& writer, const std::string& name, const torch::Tensor& matrix) {
  const torch::Tensor dense = matrix.detach().to(torch::kFloat32).contiguous();
  writer.AddFloats(name, dense.sizes().vec(),
                   {dense.data_ptr<float>(), static_cast<size_t>(dense.numel())});
}

absl::Status Refuse(const std::string& name, std::vector<std::string> problems) {
  constexpr size_t kShown = 30;
  const size_t count = problems.size();
  if (count == 0) return absl::OkStatus();
  if (count > kShown) {
    problems.resize(kShown);
    problems.push_back(absl::StrCat("... and ", count - kShown, " more"));
  }
  return absl::InvalidArgumentError(absl::StrCat(name, ": not an adapter of this policy, ", count,
                                                 " problems:\n  ",
                                                 absl::StrJoin(problems, "\n  ")));
}

// What adapter_config.json says of the scale; everything else in it must be plain LoRA.
struct PeftConfig {
  int64_t rank = 0;
  double alpha = 0;
  bool rslora = false;
  std::map<std::string, double> ranks, alphas;  // rank_pattern, alpha_pattern
};

// A map from modules to positive numbers; absent or null is empty.
void ReadPattern(const Json& json, const char* key, std::map<std::string, double>& pattern,
                 std::vector<std::string>& problems) {
  const auto found = json.find(key);
  if (found == json.end() || found->is_null()) return;
  if (!found->is_object()) {
    problems.push_back(absl::StrCat(key, " must be an object"));
    return;
  }
  for (const auto& [module, value] : found->items()) {
    if (module.find_first_of("\\^$*+?()[]{}|") != std::string::npos) {
      problems.push_back(absl::StrCat(key, " '", module,
                                      "' is a regular expression; write out the modules' names"));
    } else if (!value.is_number() || value.get<double>() <= 0 || value.get<double>() > kMaxRank) {
      problems.push_back(
          absl::StrCat(key, " '", module, "' is ", value.dump(), ", must be 1..", kMaxRank));
    } else {
      pattern[module] = value.get<double>();
    }
  }
}

PeftConfig ReadConfig(const std::string& text, std::vector<std::string>& problems) {
  PeftConfig config;
  const Json json = Json::parse(text, nullptr, /*allow_exceptions=*/false);
  if (!json.is_object()) {
    problems.push_back(absl::StrCat(kPeftConfig, " is not a JSON object"));
    return config;
  }
  const auto wants = [&](const char* key, const Json& plain, bool required) {
    const auto found = json.find(key);
    if (found == json.end() ? !required : (found->is_null() && !required) || *found == plain)
      return;
    problems.push_back(absl::StrCat(key, " is ", found == json.end() ? "absent" : found->dump(),
                                    ", only ", plain.dump(), " can be represented"));
  };
  wants("peft_type", "LORA", true);
  wants("use_dora", false, false);
  wants("bias", "none", false);
  wants("fan_in_fan_out", false, false);
  wants("modules_to_save", nullptr, false);
  const auto positive = [&](const char* key) -> double {
    const auto found = json.find(key);
    if (found != json.end() && found->is_number() && found->get<double>() > 0 &&
        found->get<double>() <= kMaxRank)
      return found->get<double>();
    problems.push_back(absl::StrCat(key, " is ", found == json.end() ? "absent" : found->dump(),
                                    ", must be a number above 0, at most ", kMaxRank));
    return 1;
  };
  config.rank = static_cast<int64_t>(positive("r"));
  config.alpha = positive("lora_alpha");
  const auto rslora = json.find("use_rslora");
  config.rslora = rslora != json.end() && *rslora == true;
  ReadPattern(json, "rank_pattern", config.ranks, problems);
  ReadPattern(json, "alpha_pattern", config.alphas, problems);
  return config;
}

// The entry of a pattern for `module`: its name or an end of it after a dot.
double PatternOr(const std::map<std::string, double>& pattern, const std::string& module,
                 double otherwise) {
  for (const auto& [key, value] : pattern) {
    if (module == key || absl::EndsWith(module, "." + key)) return value;
  }
  return otherwise;
}

absl::StatusOr<torch::Tensor> ReadMatrix(const SafetensorsFile& file, const std::string& name) {
  RS_ASSIGN_OR_RETURN(const TensorView view, file.Get(name));
  RS_ASSIGN_OR_RETURN(const std::vector<float> values, file.ReadFloats(name));
  for (const float value : values) {
    if (!std::isfinite(value)) {
      return absl::InvalidArgumentError(absl::StrCat(name, " holds ", value, ", must be finite"));
    }
  }
  return torch::tensor(values).view(view.shape);
}

// The pair of matrices in the shapes of `kind`; undefined tensors where it is not block structured.
MatrixPair FromMatrices(const LoraTarget& target, const MatrixPair& pair, LoraKind kind) {
  const int64_t heads = target.output_heads * target.input_heads;
  if (kind == LoraKind::kPerMatrix || heads == 1) return pair;
  const int64_t rank = pair.A.size(0) / heads;
  if (rank * heads != pair.A.size(0)) return {};
  std::vector<torch::Tensor> A, B;
  for (int64_t n = 0; n < heads; ++n) {
    torch::Tensor a = pair.A.narrow(0, n * rank, rank), b = pair.B.narrow(1, n * rank, rank);
    if (target.output_heads > 1) b = b.narrow(0, n * (b.size(0) / heads), b.size(0) / heads);
    if (target.input_heads > 1) a = a.narrow(1, n * (a.size(1) / heads), a.size(1) / heads);
    A.push_back(a);
    B.push_back(b);
  }
  const MatrixPair result{torch::stack(A), torch::stack(B)};
  const MatrixPair back = AsMatrices(target, result.A, result.B);
  return back.A.equal(pair.A) && back.B.equal(pair.B) ? result : MatrixPair{};
}

// One module's pair; problems are added, and the pair is then undefined.
MatrixPair ReadModule(const SafetensorsFile& file, const PeftConfig& config,
                      const LoraTarget& target, const std::string& stored_module,
                      const std::string& module, LoraKind kind,
                      std::vector<std::string>& problems) {
  const std::string a = stored_module + kA, b = stored_module + kB;
  for (const std::string& name : {a, b}) {
    if (!file.tensors().contains(name)) {
      problems.push_back(absl::StrCat("missing: ", name));
      return {};
    }
  }
  const auto &shape_a = file.tensors().at(a).shape, &shape_b = file.tensors().at(b).shape;
  const auto rank =
      static_cast<int64_t>(PatternOr(config.ranks, module, static_cast<double>(config.rank)));
  if (shape_a != std::vector<int64_t>{rank, target.in_features} ||
      shape_b != std::vector<int64_t>{target.out_features, rank}) {
    problems.push_back(
        absl::StrCat("misshaped: ", stored_module, " has A [", absl::StrJoin(shape_a, ", "),
                     "] and B [", absl::StrJoin(shape_b, ", "), "], must be [", rank, ", ",
                     target.in_features, "] and [", target.out_features, ", ", rank, "]"));
    return {};
  }
  MatrixPair pair;
  for (const auto& [name, matrix] : {std::pair(&a, &pair.A), std::pair(&b, &pair.B)}) {
    absl::StatusOr<torch::Tensor> read = ReadMatrix(file, *name);
    if (!read.ok()) {
      problems.emplace_back(read.status().message());
      return {};
    }
    *matrix = *std::move(read);
  }
  const double alpha = PatternOr(config.alphas, module, config.alpha);
  pair.B = pair.B * (alpha / (config.rslora ? std::sqrt(static_cast<double>(rank))
                                            : static_cast<double>(rank)));
  MatrixPair result = FromMatrices(target, pair, kind);
  if (!result.A.defined()) {
    problems.push_back(absl::StrCat(stored_module, ": rank ", rank,
                                    " does not split into heads with zeros between them, so it is "
                                    "no adapter per head; import it as per_matrix"));
  }
  return result;
}

}  // namespace

absl::StatusOr<PeftFiles> ToPeft(const std::vector<LoraTarget>& targets, const std::string& root,
                                 const LoraWeights& lora) {
  SafetensorsWriter writer;
  writer.SetMetadata("format", "pt");
  Json modules = Json::array(), ranks = Json::object();
  int64_t rank = kMaxRank;
  for (const torch::Tensor& A : lora.A) rank = std::min(rank, A.size(-2));
  for (size_t i = 0; i < targets.size(); ++i) {
    const std::string module = root + targets[i].name;
    const MatrixPair pair = AsMatrices(targets[i], lora.A[i], lora.B[i]);
    AddMatrix(writer, absl::StrCat(kRoot, module, kA), pair.A);
    AddMatrix(writer, absl::StrCat(kRoot, module, kB), pair.B);
    modules.push_back(module);
    if (pair.A.size(0) != rank) ranks[module] = pair.A.size(0);
  }
  const Json config = {{"peft_type", "LORA"},
                       {"base_model_name_or_path", nullptr},
                       {"task_type", nullptr},
                       {"inference_mode", true},
                       {"r", rank},
                       {"lora_alpha", rank},
                       {"lora_dropout", 0.0},
                       {"bias", "none"},
                       {"fan_in_fan_out", false},
                       {"use_rslora", false},
                       {"use_dora", false},
                       {"modules_to_save", nullptr},
                       {"target_modules", modules},
                       {"rank_pattern", ranks},
                       {"alpha_pattern", ranks}};
  PeftFiles files;
  RS_ASSIGN_OR_RETURN(files.safetensors, writer.Serialize());
  files.config_json = config.dump(2) + "\n";
  return files;
}

absl::StatusOr<LoraWeights> FromPeft(const std::string& name, const PeftFiles& files,
                                     const std::vector<LoraTarget>& targets,
                                     const std::string& root, LoraKind kind) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file,
                      SafetensorsFile::Parse(name + "/" + kPeftTensors, files.safetensors));
  std::vector<std::string> problems;
  const PeftConfig config = ReadConfig(files.config_json, problems);
  RS_RETURN_IF_ERROR(Refuse(name + "/" + kPeftConfig, problems));
  LoraWeights lora;
  std::set<std::string> known;
  int64_t rank = 0;
  for (const LoraTarget& target : targets) {
    const std::string module = root + target.name;
    // A policy that wraps the network in a member `model` has one more part in its names.
    std::string stored = kRoot + module;
    if (!file.tensors().contains(stored + kA)) {
      const std::string wrapped = absl::StrCat(kRoot, "model.", module);
      if (file.tensors().contains(wrapped + kA)) stored = wrapped;
    }
    known.insert({stored + kA, stored + kB});
    const MatrixPair pair = ReadModule(file, config, target, stored, module, kind, problems);
    if (!pair.A.defined()) continue;
    if (rank == 0) rank = pair.A.size(-2);
    if (pair.A.size(-2) != rank) {
      problems.push_back(absl::StrCat(stored, ": rank ", pair.A.size(-2), ", others have ", rank,
                                      "; an adapter here has one rank",
                                      kind == LoraKind::kPerMatrix
                                          ? ": if it was exported per head, import it as per_head"
                                          : ""));
    }
    lora.A.push_back(pair.A);
    lora.B.push_back(pair.B);
  }
  for (const auto& [tensor, view] : file.tensors()) {
    if (!known.contains(tensor)) problems.push_back(absl::StrCat("unexpected: ", tensor));
  }
  RS_RETURN_IF_ERROR(Refuse(name, problems));
  return lora;
}

}  // namespace robostress
