#pragma once

#include <cstdio>
#include <string>

// What the sources of this library use of absl::StrFormat: numbers and strings. Debian's archive of
// the original reads stderr in a way that no shared library can link.
namespace absl {
namespace standalone {

template <class T>
T Plain(T value) {
  return value;
}
inline const char* Plain(const std::string& value) { return value.c_str(); }

}  // namespace standalone

template <class... Arguments>
std::string StrFormat(const char* format, const Arguments&... arguments) {
  const int size = std::snprintf(nullptr, 0, format, standalone::Plain(arguments)...);
  std::string text(size > 0 ? static_cast<size_t>(size) : 0, '\0');
  std::snprintf(text.data(), text.size() + 1, format, standalone::Plain(arguments)...);
  return text;
}

}  // namespace absl
