#include "server/policies/openpi/policy_check.h"

#include <torch/types.h>

#include <algorithm>
#include <filesystem>
#include <optional>
#include <set>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/strip.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "server/policies/openpi/checkpoint_load.h"
#include "server/policies/openpi/openpi_lora.h"
#include "server/policies/openpi/oracle_inputs.h"
#include "server/policies/openpi/quantities.h"
#include "server/policies/tensor_io.h"

namespace robostress::openpi {
namespace {

constexpr char kExpected[] = "expected/";
constexpr int64_t kDefaultEulerSteps = 10;
constexpr int64_t kMaxEulerSteps = 1000;

bool HasPrefix(const SafetensorsFile& file, absl::string_view prefix) {
  return std::any_of(file.tensors().begin(), file.tensors().end(),
                     [&](const auto& entry) { return absl::StartsWith(entry.first, prefix); });
}

// Only tensors under the given folders may be there.
absl::Status CheckFolders(const SafetensorsFile& file, const std::vector<std::string>& folders) {
  for (const auto& [name, view] : file.tensors()) {
    if (std::none_of(folders.begin(), folders.end(), [&name = name](const std::string& folder) {
          return name.starts_with(folder);
        })) {
      return absl::InvalidArgumentError(absl::StrCat(
          file.path(), ": tensor '", name, "' is not under ", absl::StrJoin(folders, " or "),
          "; give a file with expected values, not one with weights"));
    }
  }
  return absl::OkStatus();
}

// Sizes of the network that a file was made for, where it says them.
absl::Status CheckMadeFor(const SafetensorsFile& file, const Checkpoint& weights) {
  if (!file.metadata().contains("config")) return absl::OkStatus();
  RS_ASSIGN_OR_RETURN(const OpenpiConfig other, OpenpiConfigOf(file));
  return CheckSameConfig(weights.path, weights.config, file.path(), other);
}

// The file with inputs that belongs to an io file without: a.io_x.safetensors -> a.io.safetensors.
std::string SiblingWithInputs(const std::string& io) {
  const std::filesystem::path path = io;
  const std::string name = path.filename().string();
  const size_t end = name.find(".io");
  if (end == std::string::npos) return "";
  return (path.parent_path() / (name.substr(0, end) + ".io.safetensors")).string();
}

// Opens the file that holds the inputs; nothing when io itself does.
absl::StatusOr<std::optional<SafetensorsFile>> OpenInputs(const CheckOptions& options,
                                                          const SafetensorsFile& io) {
  std::string path = options.inputs;
  if (path.empty()) {
    if (HasPrefix(io, "inputs/")) return std::nullopt;
    path = SiblingWithInputs(options.io);
    if (path.empty() || path == options.io || !std::filesystem::exists(path)) {
      return absl::InvalidArgumentError(
          absl::StrCat(options.io, ": holds no inputs/*, and there is no '", path,
                       "' beside it; name the file that holds them with --inputs"));
    }
  }
  RS_ASSIGN_OR_RETURN(SafetensorsFile file, SafetensorsFile::Open(path));
  return file;
}

// The number of Euler steps that the expected values were made with.
absl::StatusOr<int64_t> EulerSteps(const SafetensorsFile& expected) {
  const auto times = expected.tensors().find("expected/euler.time");
  if (times == expected.tensors().end()) return kDefaultEulerSteps;
  const std::vector<int64_t>& shape = times->second.shape;
  if (shape.size() == 1 && shape[0] >= 1 && shape[0] <= kMaxEulerSteps) return shape[0];
  return absl::InvalidArgumentError(
      absl::StrCat(expected.path(), ": tensor 'expected/euler.time' is ", ShapeText(shape),
                   ", must be [steps] with 1..", kMaxEulerSteps, " steps"));
}

std::set<std::string> GradientsIn(const SafetensorsFile& expected) {
  std::set<std::string> names;
  for (const auto& [name, view] : expected.tensors()) {
    absl::string_view parameter = name;
    if (absl::ConsumePrefix(&parameter, "expected/grad/")) names.emplace(parameter);
  }
  return names;
}

// What the oracle suggests for float32. Masks, positions, bins and the times that the loop visits
// are exact.
double ToleranceOf(const std::string& name, const torch::Tensor& expected) {
  if (expected.dtype() != torch::kFloat32 || name == "euler.time") return 0;
  if (name.starts_with("grad/")) {
    const double largest = expected.numel() == 0 ? 0 : expected.abs().max().item<double>();
    return 1e-4 * largest + 1e-7;
  }
  if (name == "loss.mean") return 1e-5;
  if (name == "loss.elements") return 5e-4;
  return 1e-4;
}

double LargestError(const torch::Tensor& computed, const torch::Tensor& expected) {
  if (expected.numel() == 0) return 0;
  return (computed.to(torch::kFloat64) - expected.to(torch::kFloat64)).abs().max().item<double>();
}

// Compares the tensors of one file with what the network computes.
class Comparison {
 public:
  Comparison(const SafetensorsFile& file, Quantities& quantities)
      : file_(file), quantities_(quantities) {}

  absl::Status Add(const std::string& name, const TensorView& view) {
    const std::string where = absl::StrCat(file_.path(), ": tensor '", kExpected, name, "'");
    RS_ASSIGN_OR_RETURN(const torch::Tensor expected, ToTensor(where, view));
    auto computed = quantities_.Compute(name);
    if (!computed.ok())
      return absl::InvalidArgumentError(absl::StrCat(where, ": ", computed.status().message()));
    if (!computed->defined()) {
      results_.push_back({name, view.shape, 0, 0, /*known=*/false, /*passed=*/false});
      return absl::OkStatus();
    }
    RS_RETURN_IF_ERROR(Compare(where, name, *computed, expected, name));
    const torch::Tensor other = quantities_.ComputeByOtherPass(name);
    if (!other.defined()) return absl::OkStatus();
    return Compare(where, name, other, expected,
                   name + (name == "loss.v_t" ? " (cached pass)" : " (joint pass)"));
  }

  std::vector<QuantityResult> TakeResults() { return std::move(results_); }

 private:
  absl::Status Compare(const std::string& where, const std::string& name,
                       const torch::Tensor& computed, const torch::Tensor& expected,
                       const std::string& label) {
    if (computed.sizes() != expected.sizes()) {
      return absl::InvalidArgumentError(
          absl::StrCat(where, " has shape ", ShapeText(expected.sizes()),
                       ", this network and these inputs give ", ShapeText(computed.sizes()),
                       "; give the io file that was made with these weights"));
    }
    QuantityResult result;
    result.name = label;
    result.shape = expected.sizes().vec();
    result.error = LargestError(computed, expected);
    result.tolerance = ToleranceOf(name, expected);
    result.passed = result.error <= result.tolerance;  // false for NaN
    results_.push_back(std::move(result));
    return absl::OkStatus();
  }

  const SafetensorsFile& file_;
  Quantities& quantities_;
  std::vector<QuantityResult> results_;
};

// Where a quantity stands in the computation.
int StageOf(absl::string_view name) {
  constexpr const char* kStages[] = {
      "state_bins",  "siglip.patch_pos", "siglip.", "image_embeds", "prefix.", "kv.",   "time_emb",
      "adarms_cond", "suffix.",          "v_t",     "euler.",       "actions", "loss.", "grad/"};
  int stage = 0;
  for (const char* prefix : kStages) {
    if (absl::StartsWith(name, prefix)) return stage;
    ++stage;
  }
  return stage;
}

absl::StatusOr<std::vector<QuantityResult>> CompareAll(const SafetensorsFile& file,
                                                       Quantities& quantities) {
  std::vector<std::pair<int, std::string>> order;
  for (const auto& [name, view] : file.tensors()) {
    absl::string_view quantity = name;
    if (absl::ConsumePrefix(&quantity, kExpected))
      order.emplace_back(StageOf(quantity), std::string(quantity));
  }
  std::sort(order.begin(), order.end());
  Comparison comparison(file, quantities);
  for (const auto& [stage, name] : order)
    RS_RETURN_IF_ERROR(comparison.Add(name, file.tensors().at(kExpected + name)));
  return comparison.TakeResults();
}

// The part of a check that may meet LibTorch's exceptions.
absl::StatusOr<CheckReport> Check(const CheckOptions& options) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile io, SafetensorsFile::Open(options.io));
  RS_RETURN_IF_ERROR(CheckFolders(io, {"inputs/", kExpected}));
  RS_ASSIGN_OR_RETURN(const Checkpoint weights, OpenCheckpoint(options.weights));
  const OpenpiConfig& config = weights.config;
  RS_RETURN_IF_ERROR(CheckMadeFor(io, weights));
  RS_ASSIGN_OR_RETURN(OpenpiModel model, LoadCheckpoint(weights));
  RS_ASSIGN_OR_RETURN(const std::optional<SafetensorsFile> apart, OpenInputs(options, io));
  if (apart) RS_RETURN_IF_ERROR(CheckMadeFor(*apart, weights));
  RS_ASSIGN_OR_RETURN(OracleInputs inputs, LoadOracleInputs(apart ? *apart : io, config));

  std::optional<SafetensorsFile> lora_file;
  if (!options.lora.empty()) {
    RS_ASSIGN_OR_RETURN(lora_file, SafetensorsFile::Open(options.lora));
    RS_RETURN_IF_ERROR(CheckFolders(*lora_file, {"lora/", kExpected}));
    RS_RETURN_IF_ERROR(CheckMadeFor(*lora_file, weights));
    RS_ASSIGN_OR_RETURN(const OpenpiLora lora, LoadOpenpiLora(*lora_file, config));
    model = WithLora(std::move(model), lora);
  }
  const SafetensorsFile& expected = lora_file ? *lora_file : io;
  if (!HasPrefix(expected, kExpected)) {
    return absl::InvalidArgumentError(
        absl::StrCat(expected.path(),
                     ": holds no expected/*, so there is nothing to check; give a "
                     "file with expected values"));
  }
  RS_ASSIGN_OR_RETURN(const int64_t steps, EulerSteps(expected));
  Quantities quantities(std::move(model), std::move(inputs), GradientsIn(expected), steps);
  CheckReport report;
  report.model = config.name();
  RS_ASSIGN_OR_RETURN(report.results, CompareAll(expected, quantities));
  return report;
}

}  // namespace

int64_t CheckReport::num_failed() const {
  return std::count_if(results.begin(), results.end(),
                       [](const QuantityResult& result) { return !result.passed; });
}

absl::StatusOr<CheckReport> CheckPolicy(const CheckOptions& options) {
  try {
    return Check(options);
  } catch (const std::exception& error) {  // LibTorch reports short memory and its own bugs so
    return absl::InternalError(absl::StrCat("the computation failed: ", error.what()));
  }
}

}  // namespace robostress::openpi
