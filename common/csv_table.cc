#include "common/csv_table.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<CsvTable> CsvTable::Read(const std::string& path, uint64_t max_bytes) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFileUpTo(path, max_bytes));
  CsvTable table;
  table.path_ = path;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    if (!line.empty() && line.back() == '\r') line.remove_suffix(1);
    if (line.empty()) continue;
    std::vector<std::string> cells;
    for (const absl::string_view cell : absl::StrSplit(line, ','))
      cells.emplace_back(absl::StripAsciiWhitespace(cell));
    table.rows_.push_back(std::move(cells));
  }
  if (table.rows_.size() < 2)
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": has no rows; a line of names and rows of numbers are wanted"));
  table.names_ = std::move(table.rows_.front());
  table.rows_.erase(table.rows_.begin());
  if (table.rows_.back().size() < table.names_.size()) table.rows_.pop_back();
  for (size_t i = 0; i < table.rows_.size(); ++i) {
    if (table.rows_[i].size() != table.names_.size())
      return absl::InvalidArgumentError(absl::StrCat(path, ":", i + 2, ": has ",
                                                     table.rows_[i].size(), " columns, not ",
                                                     table.names_.size()));
  }
  return table;
}

bool CsvTable::Has(const std::string& name) const {
  return std::find(names_.begin(), names_.end(), name) != names_.end();
}

absl::StatusOr<size_t> CsvTable::Column(const std::string& name) const {
  const auto at = std::find(names_.begin(), names_.end(), name);
  if (at == names_.end())
    return absl::InvalidArgumentError(absl::StrCat(path_, ": has no column '", name,
                                                   "'; its columns are ",
                                                   absl::StrJoin(names_, ", ").substr(0, 400)));
  return static_cast<size_t>(at - names_.begin());
}

std::string CsvTable::Place(size_t row, size_t column) const {
  return absl::StrCat(path_, ":", row + 2, ": ", names_[column]);
}

absl::StatusOr<double> CsvTable::Number(size_t row, size_t column) const {
  double value = 0;
  if (!absl::SimpleAtod(rows_[row][column], &value) || !std::isfinite(value))
    return absl::InvalidArgumentError(absl::StrCat(Place(row, column), " is '", rows_[row][column],
                                                   "', must be a finite number"));
  return value;
}

absl::StatusOr<std::vector<double>> CsvTable::Numbers(const std::string& name) const {
  RS_ASSIGN_OR_RETURN(const size_t column, Column(name));
  std::vector<double> values(rows());
  for (size_t row = 0; row < rows(); ++row) {
    RS_ASSIGN_OR_RETURN(values[row], Number(row, column));
  }
  return values;
}

}  // namespace robostress
