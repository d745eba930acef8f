#pragma once

#include <string>

#include "absl/status/statusor.h"
#include "yaml-cpp/yaml.h"

namespace robostress {

// The one document of a YAML text; a null node for a text without any. INVALID_ARGUMENT, with
// `source` and line, for what is not YAML and for a second document, which YAML::Load would leave
// out silently.
absl::StatusOr<YAML::Node> ReadYamlDocument(const std::string& source, const std::string& text);

}  // namespace robostress
