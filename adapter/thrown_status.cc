#include "adapter/thrown_status.h"

#include <c10/util/Exception.h>

#include <new>
#include <string>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"

namespace robostress {

absl::Status ThrownStatus(absl::string_view what, const std::exception& error) {
  if (dynamic_cast<const std::bad_alloc*>(&error) != nullptr)
    return absl::ResourceExhaustedError(absl::StrCat(what, ": not enough memory"));
  const auto* torch = dynamic_cast<const c10::Error*>(&error);
  const std::string text = torch == nullptr ? error.what() : torch->what_without_backtrace();
  // A processor's allocator throws no type of its own.
  if (dynamic_cast<const c10::OutOfMemoryError*>(&error) != nullptr ||
      (torch != nullptr && absl::StrContains(text, "DefaultCPUAllocator"))) {
    return absl::ResourceExhaustedError(absl::StrCat(what, ": not enough memory: ", text));
  }
  return absl::InternalError(absl::StrCat(what, ": ", text));
}

}  // namespace robostress
