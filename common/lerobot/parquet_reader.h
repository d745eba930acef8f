#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"
#include "common/lerobot/parquet_page.h"
#include "common/lerobot/thrift_reader.h"

namespace robostress {

// Numbers of a Parquet file: of one that parquet_table.h writes, and of those that Arrow writes of
// numbers and lists of them (ParquetPages says which). What another writer did otherwise is
// refused by its name, never misread. Trusts nothing: offsets, counts and levels are checked before
// they are used.
class ParquetReader {
 public:
  // `bytes` of the whole file, `name` for errors. INVALID_ARGUMENT names file, field and value.
  static absl::StatusOr<ParquetReader> Parse(std::string name, std::string bytes);
  // The same of a file, of which only the columns that are asked for are read.
  static absl::StatusOr<ParquetReader> Open(const std::string& path);

  int64_t rows() const { return rows_; }
  size_t groups() const;  // of rows
  // A column of integers or reals; with `list` above 0 one of lists of that many each, row by row.
  absl::StatusOr<std::vector<double>> Numbers(const std::string& column, int list = 0) const;
  absl::StatusOr<std::vector<double>> NumbersOfGroup(size_t group, const std::string& column,
                                                     int list = 0) const;

 private:
  class Bytes;
  ParquetReader(std::string name, std::shared_ptr<const Bytes> bytes)
      : name_(std::move(name)), bytes_(std::move(bytes)) {}
  static absl::StatusOr<ParquetReader> ReadFooter(std::string name,
                                                  std::shared_ptr<const Bytes> bytes);
  absl::Status Wrong(const std::string& what) const;
  absl::Status FindLevels(const std::vector<std::string>& path, ParquetColumnType* type) const;
  absl::StatusOr<std::vector<double>> ReadChunk(const ThriftValue& chunk, ParquetColumnType type,
                                                size_t wanted) const;

  std::string name_;
  std::shared_ptr<const Bytes> bytes_;
  ThriftValue footer_;
  int64_t rows_ = 0;
};

}  // namespace robostress
