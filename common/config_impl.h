#pragma once

#include <type_traits>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

// Template halves of common/config.h; include that instead.
namespace robostress {

namespace config_internal {

template <class T>
struct TypeName;
template <>
struct TypeName<bool> {
  static constexpr const char* kValue = "true or false";
};
template <>
struct TypeName<int> {
  static constexpr const char* kValue = "an integer";
};
template <>
struct TypeName<int64_t> : TypeName<int> {};
template <>
struct TypeName<uint64_t> {
  static constexpr const char* kValue = "a non-negative integer";
};
template <>
struct TypeName<double> {
  static constexpr const char* kValue = "a number";
};
template <>
struct TypeName<std::string> {
  static constexpr const char* kValue = "a text";
};
template <>
struct TypeName<std::vector<int>> {
  static constexpr const char* kValue = "a list of integers";
};
template <>
struct TypeName<std::vector<int64_t>> : TypeName<std::vector<int>> {};
template <>
struct TypeName<std::vector<double>> {
  static constexpr const char* kValue = "a list of numbers";
};
template <>
struct TypeName<std::vector<std::string>> {
  static constexpr const char* kValue = "a list of texts";
};

template <class T>
bool Decode(const YAML::Node& node, T& value) {
  try {
    if constexpr (std::is_same_v<T, double>) {
      const double number = node.as<double>();
      if (number != number) return false;
      value = number;
    } else if constexpr (std::is_same_v<T, uint64_t>) {
      if (node.Scalar().find('-') != std::string::npos) return false;
      value = node.as<T>();
    } else {
      value = node.as<T>();
    }
    return true;
  } catch (const YAML::Exception&) {
    return false;
  }
}

std::string Render(const YAML::Node& node);
absl::StatusOr<YAML::Node> ParseYaml(const std::string& source, const std::string& text);
// Sets the value at "a.b.c" in a copy of the tree made of maps.
absl::StatusOr<YAML::Node> OverrideTree(const std::string& assignment);

}  // namespace config_internal

template <class T>
void ConfigReader::Field(const char* key, T& value, const char* /*doc*/) {
  YAML::Node node;
  if (!Take(key, node)) return;
  if (!config_internal::Decode(node, value)) {
    Fail(key, absl::StrCat("is '", config_internal::Render(node), "', must be ",
                           config_internal::TypeName<T>::kValue));
  }
}

template <class E>
void ConfigReader::Choice(const char* key, E& value,
                          const std::vector<std::pair<const char*, E>>& choices,
                          const char* /*doc*/) {
  YAML::Node node;
  if (!Take(key, node)) return;
  const std::string given = config_internal::Render(node);
  std::string known;
  for (const auto& [name, choice] : choices) {
    if (given == name) {
      value = choice;
      return;
    }
    absl::StrAppend(&known, known.empty() ? "" : ", ", name);
  }
  Fail(key, absl::StrCat("is '", given, "', must be one of: ", known));
}

template <class S>
void ConfigReader::Section(const char* key, S& section, const char* /*doc*/) {
  YAML::Node node;
  if (!Take(key, node)) return;
  if (!node.IsMap())
    return Fail(key, absl::StrCat("is '", config_internal::Render(node), "', must be a section"));
  ConfigReader reader(source_, node);
  reader.path_ = absl::StrCat(path_, key, ".");
  section.Visit(reader);
  reader.CheckKeys();
  complaints_.insert(complaints_.end(), reader.complaints_.begin(), reader.complaints_.end());
}

template <class T>
void ConfigReader::Late(const char* key, T& value, const T& /*usual*/, const char* doc) {
  Field(key, value, doc);
}

template <class S>
void ConfigReader::LateSection(const char* key, S& section, bool /*used*/, const char* doc) {
  Section(key, section, doc);
}

template <class T>
void ConfigWriter::Field(const char* key, T& value, const char* /*doc*/) {
  if constexpr (std::is_same_v<T, double>) {
    // Shortest text that reads back to the same number.
    char text[32];
    for (int digits = 6; digits <= 17; ++digits) {
      std::snprintf(text, sizeof(text), "%.*g", digits, value);
      if (std::strtod(text, nullptr) == value) break;
    }
    root_[key] = std::string(text);
  } else {
    root_[key] = value;
    if constexpr (!std::is_same_v<T, bool> && !std::is_arithmetic_v<T> &&
                  !std::is_same_v<T, std::string>) {
      root_[key].SetStyle(YAML::EmitterStyle::Flow);
    }
  }
}

template <class E>
void ConfigWriter::Choice(const char* key, E& value,
                          const std::vector<std::pair<const char*, E>>& choices,
                          const char* /*doc*/) {
  for (const auto& [name, choice] : choices) {
    if (choice == value) root_[key] = std::string(name);
  }
}

template <class S>
void ConfigWriter::Section(const char* key, S& section, const char* /*doc*/) {
  ConfigWriter writer;
  section.Visit(writer);
  root_[key] = writer.root_;
}

template <class T>
void ConfigWriter::Late(const char* key, T& value, const T& usual, const char* doc) {
  if (!(value == usual)) Field(key, value, doc);
}

template <class S>
void ConfigWriter::LateSection(const char* key, S& section, bool used, const char* doc) {
  if (used) Section(key, section, doc);
}

template <class Options>
absl::StatusOr<Options> ParseConfig(const std::string& source, const std::string& yaml_text) {
  RS_ASSIGN_OR_RETURN(YAML::Node root, config_internal::ParseYaml(source, yaml_text));
  Options options;
  ConfigReader reader(source, root);
  options.Visit(reader);
  RS_RETURN_IF_ERROR(reader.Finish());
  return options;
}

template <class Options>
absl::StatusOr<Options> LoadConfig(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  return ParseConfig<Options>(file, text);
}

template <class Options>
absl::Status ApplyOverrides(const std::vector<std::string>& overrides, Options& options) {
  for (const std::string& assignment : overrides) {
    RS_ASSIGN_OR_RETURN(YAML::Node tree, config_internal::OverrideTree(assignment));
    ConfigReader reader(absl::StrCat("override '", assignment, "'"), tree);
    options.Visit(reader);
    RS_RETURN_IF_ERROR(reader.Finish());
  }
  return absl::OkStatus();
}

template <class Options>
std::string DumpConfig(const Options& options) {
  Options copy = options;
  ConfigWriter writer;
  copy.Visit(writer);
  return writer.Text();
}

}  // namespace robostress
