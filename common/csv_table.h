#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "absl/strings/string_view.h"

namespace robostress {

// A table of comma-separated cells under a line of names, held in memory as its text. Lines may
// end in CR LF, empty ones are passed over, as is a byte order mark; cells have no quotes. Errors
// name file, line, column, value and remedy.
class CsvTable {
 public:
  // What a last line with too few cells is: what a full disk left and no row, or an error.
  enum class ShortLastLine { kPassedOver, kError };

  // INVALID_ARGUMENT: no rows, a name that stands twice, or a line with another number of cells
  // than the first.
  static absl::StatusOr<CsvTable> Read(const std::string& path,
                                       uint64_t max_bytes = uint64_t{1} << 32,
                                       ShortLastLine last = ShortLastLine::kPassedOver);

  const std::string& path() const { return path_; }
  const std::vector<std::string>& names() const { return names_; }
  size_t rows() const { return lines_.size(); }
  absl::StatusOr<size_t> Column(const std::string& name) const;
  bool Has(const std::string& name) const;
  // Valid as long as the table, moved or not.
  absl::string_view Text(size_t row, size_t column) const {
    return cells_[row * names_.size() + column];
  }
  // Finite.
  absl::StatusOr<double> Number(size_t row, size_t column) const;
  absl::StatusOr<std::vector<double>> Numbers(const std::string& name) const;
  // "FILE:LINE", to begin an error about a row with.
  std::string Place(size_t row) const;
  // "FILE:LINE: NAME", the same about a cell.
  std::string Place(size_t row, size_t column) const;

 private:
  std::string path_;
  std::shared_ptr<const std::string> text_;
  std::vector<std::string> names_;
  std::vector<absl::string_view> cells_;  // of text_, row by row
  std::vector<int> lines_;                // of each row in the file, from 1
};

}  // namespace robostress
