#pragma once

#include <string>

#include "absl/strings/string_view.h"

// What the sources of this library use of absl::Status, for the shared library alone: Debian's
// archive of the original holds thread-local variables that no shared library can link.
namespace absl {

enum class StatusCode : int {
  kOk = 0,
  kUnknown = 2,
  kInvalidArgument = 3,
  kNotFound = 5,
  kAlreadyExists = 6,
  kPermissionDenied = 7,
  kResourceExhausted = 8,
  kFailedPrecondition = 9,
  kUnimplemented = 12,
  kInternal = 13,
  kUnavailable = 14,
  kDataLoss = 15,
};

class [[nodiscard]] Status {
 public:
  Status() = default;
  Status(StatusCode code, string_view message)
      : code_(code), message_(code == StatusCode::kOk ? string_view() : message) {}

  // Keeps the first failure.
  void Update(const Status& other) {
    if (ok()) *this = other;
  }
  void IgnoreError() const {}
  bool ok() const { return code_ == StatusCode::kOk; }
  StatusCode code() const { return code_; }
  string_view message() const { return message_; }

 private:
  StatusCode code_ = StatusCode::kOk;
  std::string message_;
};

inline Status OkStatus() { return {}; }
inline Status InvalidArgumentError(string_view message) {
  return {StatusCode::kInvalidArgument, message};
}
inline Status NotFoundError(string_view message) { return {StatusCode::kNotFound, message}; }
inline Status AlreadyExistsError(string_view message) {
  return {StatusCode::kAlreadyExists, message};
}
inline Status PermissionDeniedError(string_view message) {
  return {StatusCode::kPermissionDenied, message};
}
inline Status ResourceExhaustedError(string_view message) {
  return {StatusCode::kResourceExhausted, message};
}
inline Status FailedPreconditionError(string_view message) {
  return {StatusCode::kFailedPrecondition, message};
}
inline Status UnimplementedError(string_view message) {
  return {StatusCode::kUnimplemented, message};
}
inline Status InternalError(string_view message) { return {StatusCode::kInternal, message}; }
inline Status UnavailableError(string_view message) { return {StatusCode::kUnavailable, message}; }
inline Status DataLossError(string_view message) { return {StatusCode::kDataLoss, message}; }
inline bool IsNotFound(const Status& status) { return status.code() == StatusCode::kNotFound; }

}  // namespace absl
