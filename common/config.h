#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "yaml-cpp/yaml.h"

namespace robostress {

// A config struct is its own schema: it has
//   template <class V> void Visit(V& v) { v.Field("rank", rank, "LoRA rank"); v.Section("osc", osc,
//   "..."); }
// Late and LateSection are for what came after texts were kept and hashed: read like the others,
// and written only where the value is not the usual one, or the section is used, so that a text of
// one who does not use it stays as it was. Fields are bool, int, int64_t, uint64_t, double,
// std::string, std::vector of these (and enums through v.Choice). Reading refuses unknown keys,
// keys that stand twice and wrong types, and names file, key path, value and the allowed keys of
// everything that is wrong, a line each.
class ConfigReader {
 public:
  ConfigReader(std::string source, const YAML::Node& root)
      : source_(std::move(source)), node_(root) {}
  template <class T>
  void Field(const char* key, T& value, const char* doc);
  template <class E>
  void Choice(const char* key, E& value, const std::vector<std::pair<const char*, E>>& choices,
              const char* doc);
  template <class S>
  void Section(const char* key, S& section, const char* doc);
  template <class T>
  void Late(const char* key, T& value, const T& usual, const char* doc);
  template <class S>
  void LateSection(const char* key, S& section, bool used, const char* doc);
  absl::Status Finish();  // everything that was wrong, with the keys that no field took

 private:
  bool Take(const char* key, YAML::Node& out);
  void Fail(const std::string& key, const std::string& message);
  void CheckKeys();
  std::string source_, path_;
  YAML::Node node_;
  std::vector<std::string> known_, complaints_;
};

// Writes a struct as YAML, fields in order.
class ConfigWriter {
 public:
  template <class T>
  void Field(const char* key, T& value, const char* doc);
  template <class E>
  void Choice(const char* key, E& value, const std::vector<std::pair<const char*, E>>& choices,
              const char* doc);
  template <class S>
  void Section(const char* key, S& section, const char* doc);
  template <class T>
  void Late(const char* key, T& value, const T& usual, const char* doc);
  template <class S>
  void LateSection(const char* key, S& section, bool used, const char* doc);
  std::string Text() const;

 private:
  YAML::Node root_{YAML::NodeType::Map};
};

// Parses YAML text (or a file) into an options struct whose defaults stand for absent keys.
template <class Options>
absl::StatusOr<Options> ParseConfig(const std::string& source, const std::string& yaml_text);
template <class Options>
absl::StatusOr<Options> LoadConfig(const std::string& file);
// Applies "a.b.c=value" overrides in order, with the same checks.
template <class Options>
absl::Status ApplyOverrides(const std::vector<std::string>& overrides, Options& options);
template <class Options>
std::string DumpConfig(const Options& options);

}  // namespace robostress

#include "common/config_impl.h"
