#pragma once

#include <exception>

#include "absl/status/status.h"
#include "absl/strings/string_view.h"

namespace robostress {

// "`what`: ..." of what LibTorch, protobuf or the standard library threw: RESOURCE_EXHAUSTED where
// memory was missing, for which LibTorch has several types and texts, INTERNAL otherwise. Without
// the stack that LibTorch adds.
absl::Status ThrownStatus(absl::string_view what, const std::exception& error);

}  // namespace robostress
