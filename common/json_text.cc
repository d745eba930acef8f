#include "common/json_text.h"

#include <algorithm>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/plain_line.h"

namespace robostress {
namespace {

// Deepest nesting of brackets outside of strings; the parser would take memory for each before it
// fails.
int DepthOf(std::string_view text) {
  int depth = 0, deepest = 0;
  bool in_string = false;
  for (size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (in_string) {
      if (c == '\\') ++i;
      if (c == '"') in_string = false;
    } else if (c == '"') {
      in_string = true;
    } else if (c == '{' || c == '[') {
      deepest = std::max(deepest, ++depth);
    } else if (c == '}' || c == ']') {
      --depth;
    }
  }
  return deepest;
}

class DuplicateKeyDetector {
 public:
  bool operator()(int /*depth*/, nlohmann::json::parse_event_t event, nlohmann::json& parsed) {
    using Event = nlohmann::json::parse_event_t;
    if (event == Event::object_start) keys_.emplace_back();
    if (event == Event::object_end) keys_.pop_back();
    if (event == Event::key && !keys_.back().insert(parsed.get<std::string>()).second) {
      duplicate_ = parsed.get<std::string>();
      found_ = true;
    }
    return true;
  }
  bool found() const { return found_; }
  const std::string& duplicate() const { return duplicate_; }

 private:
  std::vector<std::set<std::string>> keys_;
  std::string duplicate_;
  bool found_ = false;
};

}  // namespace

absl::StatusOr<nlohmann::json> ParseJsonObject(std::string_view text, int max_depth) {
  if (const int depth = DepthOf(text); depth > max_depth) {
    return absl::InvalidArgumentError(
        absl::StrCat("it is nested ", depth, " deep, the limit is ", max_depth));
  }
  DuplicateKeyDetector detector;
  nlohmann::json json = nlohmann::json::parse(text.begin(), text.end(), std::ref(detector),
                                              /*allow_exceptions=*/false);
  if (!json.is_object()) return absl::InvalidArgumentError("it is not a JSON object");
  if (detector.found()) {
    return absl::InvalidArgumentError(
        absl::StrCat("key '", PlainLine(detector.duplicate()), "' occurs twice in one object"));
  }
  return json;
}

std::string TextAt(const nlohmann::json& json, const char* key) {
  if (!json.is_object()) return "";
  const auto found = json.find(key);
  return found != json.end() && found->is_string() ? found->get<std::string>() : "";
}

}  // namespace robostress
