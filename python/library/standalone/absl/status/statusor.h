#pragma once

#include <cstdlib>
#include <optional>
#include <type_traits>
#include <utility>

#include "absl/status/status.h"

// What the sources of this library use of absl::StatusOr; see status.h.
namespace absl {

template <class T>
class [[nodiscard]] StatusOr {
 public:
  StatusOr(const Status& status) : status_(status) { CheckFailed(); }
  StatusOr(Status&& status) : status_(std::move(status)) { CheckFailed(); }
  template <class U = T, std::enable_if_t<std::is_constructible_v<T, U&&> &&
                                              !std::is_same_v<std::decay_t<U>, Status> &&
                                              !std::is_same_v<std::decay_t<U>, StatusOr>,
                                          int> = 0>
  StatusOr(U&& value) : value_(std::in_place, std::forward<U>(value)) {}

  bool ok() const { return status_.ok(); }
  const Status& status() const { return status_; }
  const T& value() const& { return CheckedValue(*this); }
  T& value() & { return CheckedValue(*this); }
  T&& value() && { return std::move(CheckedValue(*this)); }
  template <class U>
  T value_or(U&& other) const& {
    return ok() ? *value_ : static_cast<T>(std::forward<U>(other));
  }
  const T& operator*() const& { return value(); }
  T& operator*() & { return value(); }
  T&& operator*() && { return std::move(*this).value(); }
  const T* operator->() const { return &value(); }
  T* operator->() { return &value(); }

 private:
  void CheckFailed() const {
    if (status_.ok()) std::abort();
  }
  template <class Self>
  static auto& CheckedValue(Self& self) {
    if (!self.value_) std::abort();
    return *self.value_;
  }

  Status status_;
  std::optional<T> value_;
};

}  // namespace absl
