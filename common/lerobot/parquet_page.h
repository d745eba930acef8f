#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"
#include "common/lerobot/thrift_reader.h"

namespace robostress {

// Of a column of numbers, what its pages are read by.
struct ParquetColumnType {
  int64_t physical = -1;               // INT32 1, INT64 2, FLOAT 4, DOUBLE 5
  int64_t codec = 0;                   // of CompressionCodec
  int repetition = 0, definition = 0;  // the most
  int list = 0;                        // numbers of a row; 0: no list
};

// The numbers of a column chunk, page after page: data pages of version 1 and 2, plain or by a
// dictionary; not compressed, snappy or zstd; none missing. Memory is bounded by `most` and by
// kMostPage. INVALID_ARGUMENT names what is otherwise.
class ParquetPages {
 public:
  static constexpr int64_t kMostPage = int64_t{256} << 20;  // inflated [bytes]

  ParquetPages(const ParquetColumnType& type, size_t most) : type_(type), most_(most) {}
  // `body`: the page behind its header.
  absl::Status Take(const ThriftValue& header, absl::string_view body);
  const std::vector<double>& numbers() const { return numbers_; }

 private:
  absl::Status TakeDictionary(const ThriftValue& page, absl::string_view values);
  absl::Status TakeValues(int64_t encoding, int64_t count, absl::string_view values);
  absl::Status CheckLevels(const std::vector<uint32_t>& repetition,
                           const std::vector<uint32_t>& definition) const;
  absl::Status TakeFirstVersion(const ThriftValue& page, absl::string_view body);
  absl::Status TakeSecondVersion(const ThriftValue& page, absl::string_view body, int64_t size);

  const ParquetColumnType type_;
  const size_t most_;
  bool has_dictionary_ = false;
  std::vector<double> dictionary_, numbers_;
};

}  // namespace robostress
