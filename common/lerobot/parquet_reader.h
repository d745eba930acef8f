#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "common/lerobot/thrift_reader.h"

namespace robostress {

// Numbers of a Parquet file as parquet_table.h writes it: plain values, not compressed, data pages
// of version 1, none missing. What another writer did otherwise is refused by its name, never
// misread. Trusts nothing: offsets, counts and levels are checked before they are used.
class ParquetReader {
 public:
  // `bytes` of the whole file, `name` for errors. INVALID_ARGUMENT names file, field and value.
  static absl::StatusOr<ParquetReader> Parse(std::string name, std::string bytes);

  int64_t rows() const { return rows_; }
  // A column of integers or reals; with `list` above 0 one of lists of that many each, row by row.
  absl::StatusOr<std::vector<double>> Numbers(const std::string& column, int list = 0) const;

 private:
  struct Levels {
    int repetition = 0, definition = 0;  // the most
  };
  ParquetReader(std::string name, std::string bytes)
      : name_(std::move(name)), bytes_(std::move(bytes)) {}
  absl::Status Wrong(const std::string& what) const;
  absl::StatusOr<Levels> LevelsOf(const std::vector<std::string>& path) const;
  // Until `numbers` are `most`.
  absl::Status ReadChunk(const ThriftValue& chunk, Levels levels, int list, size_t most,
                         std::vector<double>* numbers) const;
  absl::Status ReadPage(std::string_view page, const ThriftValue& header, int64_t type,
                        Levels levels, int list, size_t most, std::vector<double>* numbers) const;

  std::string name_, bytes_;
  ThriftValue footer_;
  int64_t rows_ = 0;
};

}  // namespace robostress
