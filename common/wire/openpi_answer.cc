#include "common/wire/openpi_answer.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr size_t kMostText = 1024;  // bytes of a server's words that an error repeats

// On one line, of a length that a log takes.
std::string Words(std::string_view text) {
  std::string words(text.substr(0, kMostText));
  std::replace_if(
      words.begin(), words.end(), [](unsigned char c) { return c < ' ' || c == 127; }, ' ');
  return words;
}

// For an error: "actions [10, 32], state [8], ..." of a map.
std::string Shown(const OpenpiValue& answer) {
  if (answer.map() == nullptr) return "neither a map nor an array";
  std::vector<std::string> shown;
  for (const auto& [key, value] : *answer.map()) {
    if (shown.size() == 16) break;
    const auto* array = std::get_if<OpenpiArray>(&value.value);
    shown.push_back(absl::StrCat(
        Words(key.substr(0, 64)),
        array == nullptr ? "" : absl::StrCat(" [", absl::StrJoin(array->shape, ", "), "]")));
  }
  return shown.empty() ? "an empty map" : absl::StrCat("a map of ", absl::StrJoin(shown, ", "));
}

double Milliseconds(const OpenpiValue& answer, std::string_view timing) {
  const OpenpiValue* found = answer.Find(timing);
  const OpenpiValue* ms = found == nullptr ? nullptr : found->Find("infer_ms");
  if (ms == nullptr) return 0;
  const auto* whole = std::get_if<int64_t>(&ms->value);
  const auto* number = std::get_if<double>(&ms->value);
  const double value = whole ? static_cast<double>(*whole) : number ? *number : 0;
  return std::isfinite(value) && value >= 0 ? value : 0;
}

}  // namespace

absl::Status OpenpiRefusal(const OpenpiValue& answer) {
  const OpenpiValue* type = answer.Find("type");
  const auto* text = type == nullptr ? nullptr : std::get_if<std::string_view>(&type->value);
  if (text == nullptr || *text != "error") return absl::OkStatus();
  const OpenpiValue* message = answer.Find("message");
  const auto* words = message == nullptr ? nullptr : std::get_if<std::string_view>(&message->value);
  return absl::InternalError(
      absl::StrCat("the policy server refuses: ", words == nullptr ? "no message" : Words(*words)));
}

const OpenpiValue* OpenpiActionsIn(const OpenpiValue& answer) {
  if (std::holds_alternative<OpenpiArray>(answer.value)) return &answer;
  for (const char* key : {"actions", "action"})
    if (const OpenpiValue* actions = answer.Find(key)) return actions;
  const OpenpiValue::Map* map = answer.map();
  return map != nullptr && map->size() == 1 ? &map->begin()->second : nullptr;
}

absl::StatusOr<OpenpiAnswer> ReadOpenpiAnswer(const OpenpiValue& answer, OpenpiSide rows,
                                              OpenpiSide cols) {
  RS_RETURN_IF_ERROR(OpenpiRefusal(answer));
  const OpenpiValue* found = OpenpiActionsIn(answer);
  if (found == nullptr || !std::holds_alternative<OpenpiArray>(found->value)) {
    return absl::InvalidArgumentError(absl::StrCat(
        "the answer is ", Shown(answer),
        "; expected an array [horizon, action_dim] under 'actions', or nothing but that array"));
  }
  OpenpiValue actions = *found;
  std::vector<int64_t>& shape = std::get<OpenpiArray>(actions.value).shape;
  if (shape.size() == 3 && shape[0] == 1) shape.erase(shape.begin());
  if (shape.size() == 1 && shape[0] > 1) shape.insert(shape.begin(), 1);
  RS_ASSIGN_OR_RETURN(const Eigen::MatrixXd numbers, OpenpiMatrix("actions", actions, rows, cols));
  OpenpiAnswer result;
  result.actions = numbers.cast<float>();
  if (!result.actions.allFinite())
    return absl::InvalidArgumentError("actions: a value is beyond float32");
  result.infer_ms = Milliseconds(answer, "policy_timing");
  if (result.infer_ms == 0) result.infer_ms = Milliseconds(answer, "server_timing");
  return result;
}

absl::Status OpenpiErrorText(const std::string& text) {
  std::string words = text;
  absl::StripAsciiWhitespace(&words);
  words.erase(0, words.rfind('\n') + 1);
  return absl::InternalError(absl::StrCat("the policy server failed: ", Words(words)));
}

}  // namespace robostress
