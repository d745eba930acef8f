#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// A table of comma-separated cells under a line of names, held in memory. Lines may end in CR LF;
// cells have no quotes. Errors name file, line, column, value and remedy.
class CsvTable {
 public:
  // INVALID_ARGUMENT: no rows, or a line with another number of cells than the first. A last line
  // that is cut short, as a full disk leaves it, is passed over.
  static absl::StatusOr<CsvTable> Read(const std::string& path,
                                       uint64_t max_bytes = uint64_t{1} << 32);

  const std::string& path() const { return path_; }
  const std::vector<std::string>& names() const { return names_; }
  size_t rows() const { return rows_.size(); }
  absl::StatusOr<size_t> Column(const std::string& name) const;
  bool Has(const std::string& name) const;
  const std::string& Text(size_t row, size_t column) const { return rows_[row][column]; }
  // Finite.
  absl::StatusOr<double> Number(size_t row, size_t column) const;
  absl::StatusOr<std::vector<double>> Numbers(const std::string& name) const;
  // "FILE:LINE: NAME", to begin an error about a cell with.
  std::string Place(size_t row, size_t column) const;

 private:
  std::string path_;
  std::vector<std::string> names_;
  std::vector<std::vector<std::string>> rows_;
};

}  // namespace robostress
