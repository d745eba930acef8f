#pragma once

#include <algorithm>
#include <cstddef>
#include <cstring>
#include <exception>
#include <new>
#include <string>
#include <string_view>

#include "absl/status/status.h"
#include "absl/strings/str_cat.h"
#include "common/status_macros.h"
#include "python/library/robostress.h"

// The border to C: no exception, no C++ type.
namespace robostress {

// Writes `message` to text[0 .. size - 1], cut before a byte that continues a character.
void WriteMessage(absl::string_view message, char* text, size_t size);
robostress_code CodeOf(const absl::Status& status);

template <class Function>
robostress_code AtBoundary(char* error, size_t error_size, Function function) noexcept {
  try {
    const absl::Status status = function();
    if (!status.ok()) WriteMessage(status.message(), error, error_size);
    return CodeOf(status);
  } catch (const std::bad_alloc&) {
    WriteMessage("no memory is left", error, error_size);
  } catch (const std::exception& fault) {
    WriteMessage(fault.what(), error, error_size);
  } catch (...) {
    WriteMessage("unknown fault", error, error_size);
  }
  return ROBOSTRESS_INTERNAL;
}

inline absl::Status CheckHandle(const char* name, const void* pointer) {
  return pointer != nullptr ? absl::OkStatus()
                            : absl::InvalidArgumentError(absl::StrCat(name, " is NULL"));
}

template <class Value>
struct Word {
  const char* text;
  Value value;
};

template <class Value, size_t n>
absl::Status ReadWord(const char* name, const char* text, const Word<Value> (&words)[n],
                      Value& value) {
  std::string known;
  for (const auto& word : words) {
    if (text != nullptr && std::string_view(text) == word.text) {
      value = word.value;
      return absl::OkStatus();
    }
    absl::StrAppend(&known, known.empty() ? "" : ", ", word.text);
  }
  return absl::InvalidArgumentError(absl::StrCat(name, " is '",
                                                 text == nullptr ? "NULL" : absl::string_view(text),
                                                 "', must be one of ", known));
}

// What `to` covers of `from`, by the size that each says; `to.size` stays.
template <class Structure>
void CopyStructure(const Structure& from, Structure& to) {
  const size_t size = to.size;
  std::memcpy(&to, &from, std::min(size, sizeof(Structure)));
  to.size = size;
}

// The fields of `given` over those of `to`. A structure of a later version may not say more than
// this library knows.
template <class Structure>
absl::Status ReadStructure(const char* name, const Structure* given, Structure& to) {
  RS_RETURN_IF_ERROR(CheckHandle(name, given));
  if (given->size < sizeof(size_t) || given->size > sizeof(Structure)) {
    return absl::InvalidArgumentError(
        absl::StrCat(name, ".size is ", given->size, ", must be sizeof(*", name, "), at most ",
                     sizeof(Structure), " in this version; set it before the call"));
  }
  std::memcpy(&to, given, given->size);
  to.size = sizeof(Structure);
  return absl::OkStatus();
}

}  // namespace robostress
