#pragma once

#include <utility>

#include "absl/status/statusor.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/config.h"
#include "common/rollout/session_spec.h"
#include "common/status_macros.h"

namespace robostress {

// INVALID_ARGUMENT names spec.method_yaml and what is wrong with it.
inline absl::StatusOr<SessionSpec> ReadSpec(const RequestedSession& request) {
  RS_ASSIGN_OR_RETURN(MethodOptions method, ParseMethod("spec.method_yaml", request.method_yaml));
  return SessionSpec{request, std::move(method)};
}

// Of a request that a server wrote: its dump names every option that its version had, and those
// that came later are at their defaults, which change nothing, and not at the preset's.
inline absl::StatusOr<SessionSpec> ReadStoredSpec(const RequestedSession& request) {
  RS_ASSIGN_OR_RETURN(MethodOptions method,
                      ParseConfig<MethodOptions>("spec.method_yaml", request.method_yaml));
  return SessionSpec{request, std::move(method)};
}

// With a dump of all options.
inline RequestedSession RequestOf(const SessionSpec& spec) {
  return RequestedSession{spec, DumpConfig(*spec.method)};
}

}  // namespace robostress
