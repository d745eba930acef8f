#include "eval/plan/unit_text.h"

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "adapter/method_options.h"
#include "common/config.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr int kHeadLines = 5;
constexpr const char* kHeadKeys[kHeadLines] = {
    "suite: ", "scenario: ", "severity: ", "policy: ", "seed: "};

// Where line `count` of a text begins; npos when it has fewer.
size_t LineStart(const std::string& text, int count) {
  size_t at = 0;
  for (int i = 0; i < count && at != std::string::npos; ++i) {
    at = text.find('\n', at);
    if (at != std::string::npos) ++at;
  }
  return at;
}

// The first five lines are the five keys, each on a line of its own.
bool HasPlainHead(const std::string& text) {
  size_t at = 0;
  for (const char* key : kHeadKeys) {
    if (at == std::string::npos || !absl::StartsWith(absl::string_view(text).substr(at), key))
      return false;
    at = text.find('\n', at);
    if (at != std::string::npos) ++at;
  }
  return at != std::string::npos;
}

}  // namespace

std::string UnitTexts::Of(const PlannedUnit& unit) {
  const UnitConfig& config = unit.config;
  std::string& tail = tails_[absl::StrCat(config.suite, "\n", config.method->method)];
  if (tail.empty()) {
    const std::string text = DumpConfig(config);
    if (!HasPlainHead(text)) return text;  // a name that YAML writes over several lines
    tail = text.substr(LineStart(text, kHeadLines));
  }
  const auto head = [this](int line, const std::string& value, auto set) -> const std::string& {
    std::string& rendered = heads_[absl::StrCat(line, value)];
    if (rendered.empty()) {
      UnitConfig alone;
      set(alone);
      const std::string text = DumpConfig(alone);
      const size_t start = LineStart(text, line);
      rendered = text.substr(start, LineStart(text, line + 1) - start);
    }
    return rendered;
  };
  std::string text = head(0, config.suite, [&](UnitConfig& c) { c.suite = config.suite; });
  text += head(1, config.scenario, [&](UnitConfig& c) { c.scenario = config.scenario; });
  text +=
      head(2, absl::StrCat(config.severity), [&](UnitConfig& c) { c.severity = config.severity; });
  text += head(3, config.policy, [&](UnitConfig& c) { c.policy = config.policy; });
  text += head(4, absl::StrCat(config.seed), [&](UnitConfig& c) { c.seed = config.seed; });
  return text += tail;
}

absl::StatusOr<UnitConfig> UnitTextReader::Read(const std::string& source,
                                                const std::string& text) {
  if (!HasPlainHead(text)) return ParseConfig<UnitConfig>(source, text);
  const size_t tail_start = LineStart(text, kHeadLines);
  const std::string tail = text.substr(tail_start);
  auto kept = tails_.find(tail);
  if (kept == tails_.end()) {
    RS_ASSIGN_OR_RETURN(UnitConfig config, ParseConfig<UnitConfig>(source, tail));
    kept = tails_.emplace(tail, std::move(config)).first;
  }
  UnitConfig config = kept->second;
  size_t at = 0;
  for (int i = 0; i < kHeadLines; ++i) {
    const size_t next = text.find('\n', at) + 1;
    const std::string line = text.substr(at, next - at);
    at = next;
    auto value = heads_.find(line);
    if (value == heads_.end()) {
      RS_ASSIGN_OR_RETURN(UnitConfig alone, ParseConfig<UnitConfig>(source, line));
      value = heads_.emplace(line, std::move(alone)).first;
    }
    const UnitConfig& head = value->second;
    if (i == 0) config.suite = head.suite;
    if (i == 1) config.scenario = head.scenario;
    if (i == 2) config.severity = head.severity;
    if (i == 3) config.policy = head.policy;
    if (i == 4) config.seed = head.seed;
  }
  return config;
}

}  // namespace robostress
