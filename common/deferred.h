#pragma once

#include <concepts>
#include <memory>
#include <type_traits>
#include <utility>

namespace robostress {

// A value of a type that only those must see who read or change it: a struct that carries a
// Deferred<T> needs no more than `struct T;`. Copies are independent of each other and share what
// they hold. A new one is T{}.
template <class T>
class Deferred {
 public:
  Deferred() = default;
  template <class U>
  // NOLINTNEXTLINE(bugprone-forwarding-reference-overload): U is T, so it hides no copy.
  requires std::same_as<std::remove_cvref_t<U>, T> Deferred(U&& value)
      : value_(std::make_shared<const T>(std::forward<U>(value))) {}

  const T& operator*() const {
    static const T kNew{};
    return value_ == nullptr ? kNew : *value_;
  }
  const T* operator->() const { return &**this; }
  // To change it in place; what other copies hold stays.
  T& Edit() {
    auto copy = std::make_shared<T>(**this);
    T& result = *copy;
    value_ = std::move(copy);
    return result;
  }
  // A section of a configuration (common/config.h).
  template <class V>
  void Visit(V& v) {
    Edit().Visit(v);
  }

 private:
  std::shared_ptr<const T> value_;
};

}  // namespace robostress
