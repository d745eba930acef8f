#include "server/policies/nano/nano_weights.h"

#include <torch/types.h>

#include <cmath>
#include <cstring>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/config.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "server/policies/nano/nano_network.h"

namespace robostress {
namespace {

constexpr char kRemedy[] =
    "; train it again with robostress-train or take the file that belongs to this version";

std::string Shape(const std::vector<int64_t>& shape) {
  return absl::StrCat("[", absl::StrJoin(shape, ","), "]");
}

// A tensor of the file, and where its values go.
struct Wanted {
  std::string name;
  std::vector<int64_t> shape;
  float* values;
};

std::vector<Wanted> NormalisationTensors(NanoModel& model) {
  std::vector<Wanted> wanted;
  const auto add = [&](const std::string& name, ZScore& z, int dim) {
    z.mean.resize(dim);
    z.std.resize(dim, 1.0f);
    wanted.push_back({absl::StrCat("normalize.", name, ".mean"), {dim}, z.mean.data()});
    wanted.push_back({absl::StrCat("normalize.", name, ".std"), {dim}, z.std.data()});
  };
  add("state", model.state, model.config.state_dim);
  add("actions", model.actions, model.config.action_dim);
  add("aux", model.aux, model.config.aux_dim);
  return wanted;
}

// Copies one tensor after checking it; a description of the problem, or empty.
std::string ReadTensor(const SafetensorsFile& file, const Wanted& wanted) {
  const auto found = file.tensors().find(wanted.name);
  if (found == file.tensors().end()) return absl::StrCat(wanted.name, " is missing");
  const TensorView& view = found->second;
  if (view.dtype != DType::kF32)
    return absl::StrCat(wanted.name, " is ", DTypeName(view.dtype), ", must be F32");
  if (view.shape != wanted.shape) {
    return absl::StrCat(wanted.name, " has shape ", Shape(view.shape), ", must be ",
                        Shape(wanted.shape));
  }
  std::memcpy(wanted.values, view.bytes.data(), view.bytes.size());
  for (int64_t i = 0; i < view.num_elements(); ++i) {
    if (!std::isfinite(wanted.values[i]))
      return absl::StrCat(wanted.name, " holds ", wanted.values[i], " at ", i);
  }
  return "";
}

}  // namespace

absl::Status SaveNanoModel(const NanoModel& model, const std::string& path) {
  SafetensorsWriter writer;
  writer.SetMetadata("format", kNanoFormat);
  writer.SetMetadata("format_version", kNanoFormatVersion);
  writer.SetMetadata("config", DumpConfig(model.config));
  writer.SetMetadata("vocabulary", absl::StrJoin(model.vocabulary.words(), " "));
  const std::vector<NanoTensorInfo> table = NanoTensorTable(model.config);
  for (size_t i = 0; i < table.size(); ++i) {
    const torch::Tensor tensor = model.tensors[i].detach().contiguous();
    writer.AddFloats(
        table[i].name, table[i].shape,
        absl::MakeConstSpan(tensor.data_ptr<float>(), static_cast<size_t>(tensor.numel())));
  }
  NanoModel copy = model;
  for (const Wanted& wanted : NormalisationTensors(copy)) {
    writer.AddFloats(wanted.name, wanted.shape,
                     absl::MakeConstSpan(wanted.values, static_cast<size_t>(wanted.shape[0])));
  }
  return writer.Write(path);
}

absl::StatusOr<NanoModel> LoadNanoModel(const std::string& path) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(path));
  const auto metadata = [&](const std::string& key) {
    const auto found = file.metadata().find(key);
    return found == file.metadata().end() ? std::string() : found->second;
  };
  if (metadata("format") != kNanoFormat) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": format is '", metadata("format"),
                                                   "', must be '", kNanoFormat,
                                                   "': not a nano weights file", kRemedy));
  }
  if (metadata("format_version") != kNanoFormatVersion) {
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": format_version is '", metadata("format_version"),
                     "', this program reads '", kNanoFormatVersion, "'", kRemedy));
  }
  NanoModel model;
  RS_ASSIGN_OR_RETURN(model.config,
                      ParseConfig<NanoConfig>(path + ": metadata config", metadata("config")));
  if (absl::Status status = ValidateNanoConfig(model.config); !status.ok()) {
    return absl::InvalidArgumentError(absl::StrCat(path, ": ", status.message()));
  }
  model.vocabulary = Vocabulary(absl::StrSplit(metadata("vocabulary"), ' ', absl::SkipEmpty()));
  std::vector<std::string> problems;
  const size_t rows = model.vocabulary.words().size() + Vocabulary::kFirstWord;
  if (rows > static_cast<size_t>(model.config.vocabulary_rows)) {
    problems.push_back(absl::StrCat("the vocabulary needs ", rows, " rows, the word table has ",
                                    model.config.vocabulary_rows));
  }

  std::vector<Wanted> wanted = NormalisationTensors(model);
  for (const NanoTensorInfo& info : NanoTensorTable(model.config)) {
    model.tensors.push_back(torch::empty(info.shape));
    wanted.push_back({info.name, info.shape, model.tensors.back().data_ptr<float>()});
  }
  std::set<std::string> known;
  for (const Wanted& w : wanted) {
    known.insert(w.name);
    if (std::string problem = ReadTensor(file, w); !problem.empty())
      problems.push_back(std::move(problem));
  }
  for (const auto& [name, view] : file.tensors()) {
    if (!known.contains(name)) problems.push_back(absl::StrCat(name, " is unknown"));
  }
  if (!problems.empty()) {
    return absl::InvalidArgumentError(absl::StrCat(
        path, ": ", problems.size(), " problems: ", absl::StrJoin(problems, "; "), kRemedy));
  }
  return model;
}

NanoModel RandomNanoModel(const NanoConfig& config, uint64_t seed) {
  NanoModel model;
  model.config = config;
  NormalisationTensors(model);
  model.tensors = RandomNanoTensors(config, seed);
  return model;
}

}  // namespace robostress
