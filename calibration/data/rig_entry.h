#pragma once

#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cmath>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress::calibration {

// A place in a rig file: its value, or an INVALID_ARGUMENT that names the place.
class RigEntry {
 public:
  RigEntry(const YAML::Node& node, std::string path) : node_(node), path_(std::move(path)) {}

  template <class... Parts>
  absl::Status Error(const Parts&... parts) const {
    return absl::InvalidArgumentError(
        absl::StrCat(path_, path_.back() == ':' ? " " : ": ", parts...));
  }
  RigEntry operator[](const std::string& key) const {
    return RigEntry(node_.IsMap() ? node_[key] : YAML::Node(YAML::NodeType::Undefined),
                    absl::StrCat(path_, path_.back() == ':' ? " " : ".", key));
  }
  RigEntry operator[](size_t index) const {
    return RigEntry(node_[index], absl::StrCat(path_, "[", index, "]"));
  }
  bool present() const { return node_.IsDefined() && !node_.IsNull(); }
  const YAML::Node& node() const { return node_; }
  const std::string& path() const { return path_; }

  absl::Status CheckKeys(const std::vector<std::string>& allowed) const {
    if (!node_.IsMap()) return Error("must be a map with ", absl::StrJoin(allowed, ", "));
    RS_RETURN_IF_ERROR(CheckOnce());
    for (const auto& pair : node_) {
      const std::string key = pair.first.Scalar();
      if (std::find(allowed.begin(), allowed.end(), key) == allowed.end())
        return Error("unknown key '", key, "'; known: ", absl::StrJoin(allowed, ", "));
    }
    return absl::OkStatus();
  }
  // Of a key that stands twice the reader of YAML takes one and says nothing.
  absl::Status CheckOnce() const {
    std::set<std::string> seen;
    for (const auto& pair : node_) {
      if (!seen.insert(pair.first.Scalar()).second)
        return Error("key '", pair.first.Scalar(), "' is given twice; remove one");
    }
    return absl::OkStatus();
  }
  absl::StatusOr<std::string> Text() const {
    if (!present()) return Error("is missing");
    if (!node_.IsScalar() || node_.Scalar().empty()) return Error("must be a text");
    return node_.Scalar();
  }
  absl::StatusOr<double> Number() const {
    if (!present()) return Error("is missing");
    double value = 0;
    if (!node_.IsScalar() || !YAML::convert<double>::decode(node_, value) || !std::isfinite(value))
      return Error("is '", node_.IsScalar() ? node_.Scalar() : "not a scalar",
                   "', must be a finite number");
    return value;
  }
  absl::StatusOr<std::vector<std::string>> Texts() const {
    std::vector<std::string> texts;
    if (!present()) return texts;
    if (!node_.IsSequence()) return Error("must be a list of names");
    for (size_t i = 0; i < node_.size(); ++i) {
      RS_ASSIGN_OR_RETURN(std::string text, (*this)[i].Text());
      if (std::find(texts.begin(), texts.end(), text) != texts.end())
        return (*this)[i].Error("is '", text, "' again; leave one");
      texts.push_back(std::move(text));
    }
    return texts;
  }
  template <class E>
  absl::Status Choice(const std::vector<std::pair<std::string, E>>& choices, E& value) const {
    if (!present()) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(const std::string text, Text());
    std::vector<std::string> names;
    for (const auto& [name, choice] : choices) {
      if (name == text) {
        value = choice;
        return absl::OkStatus();
      }
      names.push_back(name);
    }
    return Error("is '", text, "', must be one of ", absl::StrJoin(names, ", "));
  }
  // Leaves `value` where the key is absent.
  absl::Status Optional(double low, double& value) const {
    if (!present()) return absl::OkStatus();
    RS_ASSIGN_OR_RETURN(value, Number());
    if (value < low) return Error("is ", value, ", must be at least ", low);
    return absl::OkStatus();
  }

 private:
  YAML::Node node_;
  std::string path_;
};

}  // namespace robostress::calibration
