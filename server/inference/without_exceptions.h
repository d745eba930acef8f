#pragma once

#include <exception>
#include <new>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"

namespace robostress {

// What `work` answers; what it throws as a status: INTERNAL, or RESOURCE_EXHAUSTED where memory was
// missing. The one place where a session's work meets what LibTorch, protobuf and the standard
// library throw: the session fails, the server goes on.
template <class Work>
auto WithoutExceptions(const char* what, Work&& work) -> decltype(work()) {
  try {
    return work();
  } catch (const std::bad_alloc&) {
    return absl::ResourceExhaustedError(absl::StrCat(what, ": not enough memory"));
  } catch (const std::exception& error) {
    return absl::InternalError(absl::StrCat(what, ": ", error.what()));
  }
}

}  // namespace robostress
