#include "common/yaml_document.h"

#include <vector>

#include "absl/strings/str_cat.h"

namespace robostress {

absl::StatusOr<YAML::Node> ReadYamlDocument(const std::string& source, const std::string& text) {
  YAML::Node only;
  try {
    for (const YAML::Node& document : YAML::LoadAll(text)) {
      if (document.IsNull()) continue;  // "---" at the end
      if (!only.IsNull()) {
        return absl::InvalidArgumentError(
            absl::StrCat(source, ": a second document begins before line ",
                         document.Mark().line + 1, "; only one is read, remove the others"));
      }
      only.reset(document);
    }
  } catch (const YAML::Exception& error) {
    return absl::InvalidArgumentError(absl::StrCat(source, ": not YAML: ", error.what()));
  }
  return only;
}

}  // namespace robostress
