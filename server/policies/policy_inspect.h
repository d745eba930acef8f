#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

namespace robostress {

// What a policy is and what it expects, and everything that keeps it from being served.
struct PolicyInspection {
  nlohmann::ordered_json content;  // sections `is` and `expects`, as far as they could be read
  std::vector<std::string> notes;  // what was assumed and why
  std::vector<std::string>
      problems;  // each with file, field, value, remedy; empty: it can be served
};

// `name_or_path`: "nano", a nano file, or a pi0 or pi0.5 checkpoint (a folder, a .safetensors file
// or an index). `options` are those of `robostress serve --policy-options`. Reads headers, norm
// stats and the tokenizer, never a weight.
PolicyInspection InspectPolicy(const std::string& name_or_path,
                               const std::vector<std::string>& options);

// One "key: value" per line, indented by sections.
std::string InspectionText(const PolicyInspection& inspection);
// {"is": .., "expects": .., "notes": [..], "problems": [..]}
std::string InspectionJson(const PolicyInspection& inspection);

}  // namespace robostress
