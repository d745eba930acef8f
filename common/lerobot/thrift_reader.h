#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// A value in Thrift's compact protocol, as Parquet's headers are written in it
// (https://github.com/apache/thrift/blob/master/doc/specs/thrift-compact-protocol.md).
struct ThriftValue {
  enum Kind { kInteger, kReal, kText, kList, kStruct } kind = kInteger;
  int64_t integer = 0;  // also of a bool
  double real = 0;
  std::string text;
  std::vector<ThriftValue> list;  // of a struct its fields
  std::vector<int> numbers;       // of the fields

  // A field; null: not there, or of another kind.
  const ThriftValue* Find(int field, Kind kind) const;
  int64_t Integer(int field, int64_t otherwise) const;
};

// The struct at the front of `bytes`, and how many bytes it takes. INVALID_ARGUMENT where they end
// too early, nest deeper than 16, or hold more than a million values or a type that Parquet has
// not.
absl::StatusOr<std::pair<ThriftValue, size_t>> ReadThriftStruct(std::string_view bytes);

}  // namespace robostress
