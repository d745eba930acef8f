#pragma once

#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// A NumPy array as openpi puts it into msgpack: a map whose keys __ndarray__, data, dtype and shape
// are bin (openpi) or str (other clients).
struct OpenpiArray {
  std::string dtype;           // NumPy's: "|u1", "<f4", "<f8", "<i8", "|b1" ...
  std::vector<int64_t> shape;  // each at least 0
  std::string_view data;       // C order; exactly as long as dtype and shape say

  size_t item_size() const { return static_cast<size_t>(dtype[2] - '0'); }  // bytes of an element
};

// A message of openpi's wire, decoded. Texts and arrays are views into the message's bytes.
struct OpenpiValue {
  using List = std::vector<OpenpiValue>;
  using Map = std::map<std::string, OpenpiValue, std::less<>>;
  std::variant<std::monostate, bool, int64_t, double, std::string_view, OpenpiArray, List, Map>
      value;

  const OpenpiValue* Find(std::string_view key) const;  // null: no map, or not in it
  const Map* map() const { return std::get_if<Map>(&value); }
};

// What one message may hold at most.
struct OpenpiLimits {
  static constexpr int kDepth = 8;
  static constexpr size_t kValues = 20000;  // maps, lists, keys and scalars together
  static constexpr int kDimensions = 8;
};

// Decodes one value and nothing after it. Trusts nothing; extension types and
// NumPy's structured, object and complex kinds are refused, so nothing is ever executed or
// converted on the client's word. INVALID_ARGUMENT names the key. Text and arrays are views of
// `message`, which outlives them.
absl::StatusOr<OpenpiValue> DecodeOpenpiValue(std::string_view message);
absl::StatusOr<OpenpiValue> DecodeOpenpiValue(std::string&& message) = delete;
// The same of a message that must be a map: all of them but some servers' answers.
absl::StatusOr<OpenpiValue> DecodeOpenpi(std::string_view message);
absl::StatusOr<OpenpiValue> DecodeOpenpi(std::string&& message) = delete;

}  // namespace robostress
