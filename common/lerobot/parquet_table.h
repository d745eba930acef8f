#pragma once

#include <cstdint>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// A column of a table; no value is missing.
struct ParquetColumn {
  std::string name;
  // Of a struct called `name`; members of one struct stand next to each other. Empty: no struct.
  std::string member;
  // bool (0 or 1), int64, float, or bytes
  std::variant<std::vector<uint8_t>, std::vector<int64_t>, std::vector<float>,
               std::vector<std::string>>
      values;
  bool text = false;  // bytes that are UTF-8
  int list = 0;       // above 0: a row is a list of this many values
};

// The bytes of a Parquet file with one row group: plain encoding, not compressed (pictures are
// already), data pages of version 1. https://parquet.apache.org/docs/file-format. Debian 12 has no
// Arrow; a data set's tables need this much of the format and no more. INVALID_ARGUMENT where
// columns differ in length or pass 2 GiB.
absl::StatusOr<std::string> ParquetTable(
    const std::vector<ParquetColumn>& columns,
    const std::vector<std::pair<std::string, std::string>>& metadata = {});

}  // namespace robostress
