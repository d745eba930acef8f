#include "adapter/method_way.h"

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"

namespace robostress {

absl::Status CheckOption(const char* key, double value, double low, double high) {
  if (value >= low && value <= high) return absl::OkStatus();
  return absl::InvalidArgumentError(absl::StrCat(
      key, " is ", value, ", must be ",
      absl::StrReplaceAll(absl::StrCat(low, "..", high), {{"e+0", "e"}, {"e+", "e"}})));
}

}  // namespace robostress
