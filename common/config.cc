#include "common/config.h"

#include <algorithm>
#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/yaml_document.h"

namespace robostress {

bool ConfigReader::Take(const char* key, YAML::Node& out) {
  known_.emplace_back(key);
  const YAML::Node& map = node_;  // const: a lookup must not insert
  if (!map.IsMap()) return false;
  const YAML::Node value = map[key];
  if (!value.IsDefined() || value.IsNull()) return false;
  out.reset(value);
  return true;
}

void ConfigReader::Fail(const std::string& key, const std::string& message) {
  complaints_.push_back(absl::StrCat(source_, ": ", path_, key, " ", message));
}

void ConfigReader::CheckKeys() {
  if (!node_.IsMap()) return;
  std::set<std::string> seen;
  for (const auto& entry : node_) {
    const std::string key = entry.first.Scalar();
    if (!seen.insert(key).second) Fail(key, "is given twice; remove one");
    if (std::find(known_.begin(), known_.end(), key) != known_.end()) continue;
    complaints_.push_back(absl::StrCat(source_, ": unknown key '", path_, key,
                                       "'; known keys: ", absl::StrJoin(known_, ", ")));
  }
}

absl::Status ConfigReader::Finish() {
  CheckKeys();
  if (complaints_.empty()) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrJoin(complaints_, "\n"));
}

std::string ConfigWriter::Text() const {
  YAML::Emitter emitter;
  emitter << root_;
  return absl::StrCat(emitter.c_str(), "\n");
}

namespace config_internal {

std::string Render(const YAML::Node& node) {
  if (node.IsScalar()) return node.Scalar();
  YAML::Emitter emitter;
  emitter << YAML::Flow << node;
  return emitter.c_str();
}

absl::StatusOr<YAML::Node> ParseYaml(const std::string& source, const std::string& text) {
  RS_ASSIGN_OR_RETURN(YAML::Node root, ReadYamlDocument(source, text));
  if (root.IsNull()) return YAML::Node(YAML::NodeType::Map);
  if (!root.IsMap()) {
    return absl::InvalidArgumentError(
        absl::StrCat(source, ": must be a YAML map of keys and values"));
  }
  return root;
}

absl::StatusOr<YAML::Node> OverrideTree(const std::string& assignment) {
  const size_t equals = assignment.find('=');
  if (equals == std::string::npos || equals == 0) {
    return absl::InvalidArgumentError(
        absl::StrCat("override '", assignment, "' must have the form key.key=value"));
  }
  const std::vector<std::string> keys = absl::StrSplit(assignment.substr(0, equals), '.');
  const std::string text = assignment.substr(equals + 1);
  YAML::Node value("");  // "key=" is the empty string, where a file's "key:" is the default
  try {
    if (!text.empty()) value = YAML::Load(text);
  } catch (const YAML::Exception& error) {
    return absl::InvalidArgumentError(absl::StrCat("override '", assignment, "': ", error.what()));
  }
  for (auto key = keys.rbegin(); key != keys.rend(); ++key) {
    YAML::Node parent(YAML::NodeType::Map);
    parent[*key] = value;
    value.reset(parent);
  }
  return value;
}

}  // namespace config_internal
}  // namespace robostress
