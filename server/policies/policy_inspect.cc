#include "server/policies/policy_inspect.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "server/policies/checkpoint_policies.h"
#include "server/policies/nano/nano_weights.h"
#include "server/policies/policy_registry.h"

namespace robostress {
namespace {

using nlohmann::ordered_json;

// ------------------------------------------------------------------------------------------- nano

void InspectNano(const std::string& path, PolicyInspection& inspection) {
  const absl::StatusOr<NanoModel> model = LoadNanoModel(path);
  if (!model.ok()) {
    inspection.problems.emplace_back(model.status().message());
    return;
  }
  const NanoConfig& c = model->config;
  int64_t parameters = 0;
  for (const torch::Tensor& tensor : model->tensors) parameters += tensor.numel();
  inspection.content["is"] = {{"network", c.pi05() ? "nano, after pi0.5" : "nano, after pi0"},
                              {"format", absl::StrCat(kNanoFormat, " ", kNanoFormatVersion)},
                              {"parameters", parameters},
                              {"dtype", "F32"},
                              {"words", model->vocabulary.words().size()}};
  inspection.content["expects"] = {
      {"cameras", c.cameras},
      {"image", absl::StrCat(c.image_size, " x ", c.image_size, " px, exactly")},
      {"prompt", absl::StrCat("whole words, at most ", c.max_words)},
      {"state", absl::StrCat(c.state_dim, " entries, z_score (openpi)",
                             c.pi05() ? ", as words of the prompt" : "")},
      {"actions", absl::StrCat(c.action_dim, " entries, z_score (openpi), as recorded")},
      {"horizon", c.horizon},
      {"execute_steps", c.execute_steps}};
}

// ------------------------------------------------------------------------------------------- text

std::string ScalarText(const ordered_json& value) {
  return value.is_string() ? value.get<std::string>() : value.dump();
}

void AppendText(const ordered_json& object, int indent, std::string& text) {
  size_t width = 0;
  for (const auto& [key, value] : object.items()) width = std::max(width, key.size());
  for (const auto& [key, value] : object.items()) {
    absl::StrAppend(&text, std::string(indent, ' '), key);
    if (value.is_object()) {
      absl::StrAppend(&text, "\n");
      AppendText(value, indent + 2, text);
      continue;
    }
    const std::string gap(width - key.size() + 2, ' ');
    if (!value.is_array()) {
      absl::StrAppend(&text, gap, ScalarText(value), "\n");
      continue;
    }
    std::vector<std::string> items;
    for (const ordered_json& item : value) items.push_back(ScalarText(item));
    const std::string next = absl::StrCat("\n", std::string(indent + width + 2, ' '));
    absl::StrAppend(&text, gap, items.empty() ? "none" : absl::StrJoin(items, next), "\n");
  }
}

void AppendList(const char* title, const std::vector<std::string>& lines, std::string& text) {
  if (lines.empty()) return;
  absl::StrAppend(&text, title, " (", lines.size(), ")\n");
  for (const std::string& line : lines)
    absl::StrAppend(&text, "  - ", absl::StrReplaceAll(line, {{"\n", "\n    "}}), "\n");
}

}  // namespace

PolicyInspection InspectPolicy(const std::string& name_or_path,
                               const std::vector<std::string>& options) {
  PolicyInspection inspection;
  const std::string path = WeightsPath(name_or_path);
  inspection.content["path"] = path;
  if (name_or_path == "nano" || IsNanoFile(path)) {
    InspectNano(path, inspection);
  } else {
    InspectCheckpoint(path, options, inspection);
  }
  return inspection;
}

std::string InspectionText(const PolicyInspection& inspection) {
  std::string text;
  AppendText(inspection.content, 0, text);
  AppendList("notes", inspection.notes, text);
  AppendList("problems", inspection.problems, text);
  if (inspection.problems.empty()) absl::StrAppend(&text, "can be served\n");
  return text;
}

std::string InspectionJson(const PolicyInspection& inspection) {
  ordered_json json = inspection.content;
  json["notes"] = inspection.notes;
  json["problems"] = inspection.problems;
  return json.dump(2, ' ', false, ordered_json::error_handler_t::replace) + "\n";
}

}  // namespace robostress
