#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

// Checks of single fields of what came over a wire, whichever it was. Errors are INVALID_ARGUMENT
// with field, value and limit.
namespace robostress {

template <class... Parts>
absl::Status Invalid(const Parts&... parts) {
  return absl::InvalidArgumentError(absl::StrCat(parts...));
}

absl::Status CheckRange(const char* field, uint64_t value, uint64_t low, uint64_t high);
absl::Status CheckFinite(const std::string& field, double value);
// INVALID_ARGUMENT names the first byte that is not UTF-8, which no protocol buffer and no JSON
// holds.
absl::Status CheckUtf8(const std::string& field, std::string_view text);
// A name that can stand in a path or a key: at most WireLimits::kName bytes of printable ASCII
// without spaces, quotes and backslashes.
absl::Status CheckName(const char* field, const std::string& name, bool may_be_empty = false);
// At most `limit` bytes.
absl::Status CheckText(const char* field, const std::string& text, size_t limit);

}  // namespace robostress
