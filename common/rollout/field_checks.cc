#include "common/rollout/field_checks.h"

#include <cmath>

#include "common/rollout/message_limits.h"

namespace robostress {

absl::Status CheckRange(const char* field, uint64_t value, uint64_t low, uint64_t high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return Invalid(field, " is ", value, ", must be ", low, " to ", high);
}

absl::Status CheckFinite(const std::string& field, double value) {
  if (std::isfinite(value)) return absl::OkStatus();
  return Invalid(field, " is ", value, ", must be finite");
}

absl::Status CheckUtf8(const std::string& field, std::string_view text) {
  // Bytes that may follow the first of a character, by RFC 3629, section 4.
  const auto length = [&text](size_t at) -> size_t {
    const auto byte = [&](size_t i) -> int {
      return at + i < text.size() ? static_cast<unsigned char>(text[at + i]) : -1;
    };
    const auto within = [&](size_t i, int low, int high) {
      return byte(i) >= low && byte(i) <= high;
    };
    const auto tail = [&](size_t i) { return within(i, 0x80, 0xBF); };
    const int first = byte(0);
    if (first < 0x80) return 1;
    if (first >= 0xC2 && first <= 0xDF) return tail(1) ? 2 : 0;
    if (first >= 0xE0 && first <= 0xEF) {
      const bool second = within(1, first == 0xE0 ? 0xA0 : 0x80, first == 0xED ? 0x9F : 0xBF);
      return second && tail(2) ? 3 : 0;
    }
    if (first >= 0xF0 && first <= 0xF4) {
      const bool second = within(1, first == 0xF0 ? 0x90 : 0x80, first == 0xF4 ? 0x8F : 0xBF);
      return second && tail(2) && tail(3) ? 4 : 0;
    }
    return 0;
  };
  for (size_t at = 0; at < text.size();) {
    const size_t bytes = length(at);
    if (bytes == 0) {
      return Invalid(field, ": byte ", at + 1, " of ", text.size(), " (",
                     static_cast<int>(static_cast<unsigned char>(text[at])),
                     ") is not UTF-8; send the text in UTF-8");
    }
    at += bytes;
  }
  return absl::OkStatus();
}

absl::Status CheckName(const char* field, const std::string& name, bool may_be_empty) {
  if (name.empty() && !may_be_empty) return Invalid(field, " is empty");
  if (name.size() > WireLimits::kName) {
    return Invalid(field, " has ", name.size(), " bytes, at most ", WireLimits::kName,
                   " are allowed");
  }
  for (const char c : name) {
    if (c > ' ' && c < 127 && c != '"' && c != '\'' && c != '\\') continue;
    return Invalid(field, " contains byte ", static_cast<int>(static_cast<unsigned char>(c)),
                   "; names are printable ASCII without spaces and quotes");
  }
  return absl::OkStatus();
}

absl::Status CheckText(const char* field, const std::string& text, size_t limit) {
  if (text.size() <= limit) return absl::OkStatus();
  return Invalid(field, " has ", text.size(), " bytes, at most ", limit, " are allowed");
}

}  // namespace robostress
