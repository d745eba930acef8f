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
