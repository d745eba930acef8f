#pragma once

#include <exception>

#include "adapter/thrown_status.h"

namespace robostress {

// What `work` answers; what it throws as ThrownStatus. The one place where a session's work meets
// what LibTorch, protobuf and the standard library throw: the session fails, the server goes on.
template <class Work>
auto WithoutExceptions(const char* what, Work&& work) -> decltype(work()) {
  try {
    return work();
  } catch (const std::exception& error) {
    return ThrownStatus(what, error);
  }
}

}  // namespace robostress
