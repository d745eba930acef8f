#include "common/csv_table.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"

namespace robostress {

absl::StatusOr<CsvTable> CsvTable::Read(const std::string& path, uint64_t max_bytes,
                                        ShortLastLine last) {
  RS_ASSIGN_OR_RETURN(std::string text, ReadFileUpTo(path, max_bytes));
  CsvTable table;
  table.path_ = path;
  table.text_ = std::make_shared<const std::string>(std::move(text));
  int line_number = 0;
  std::optional<absl::Status> short_line;
  // Spreadsheets begin their files with a byte order mark, which nobody sees.
  for (absl::string_view line :
       absl::StrSplit(absl::StripPrefix(*table.text_, "\xEF\xBB\xBF"), '\n')) {
    ++line_number;
    if (absl::StripAsciiWhitespace(line).empty()) continue;
    if (short_line.has_value()) return *short_line;
    const std::vector<absl::string_view> cells = absl::StrSplit(line, ',');
    if (table.names_.empty()) {
      for (const absl::string_view cell : cells) {
        const std::string name(absl::StripAsciiWhitespace(cell));
        if (table.Has(name))
          return absl::InvalidArgumentError(
              absl::StrCat(path, ":1: column '", name, "' stands twice"));
        table.names_.push_back(name);
      }
      continue;
    }
    if (cells.size() != table.names_.size()) {
      const absl::Status wrong = absl::InvalidArgumentError(absl::StrCat(
          path, ":", line_number, ": has ", cells.size(), " columns, not ", table.names_.size()));
      if (cells.size() > table.names_.size() || last == ShortLastLine::kError) return wrong;
      short_line = wrong;
      continue;
    }
    for (const absl::string_view cell : cells)
      table.cells_.push_back(absl::StripAsciiWhitespace(cell));
    table.lines_.push_back(line_number);
  }
  if (table.lines_.empty())
    return absl::InvalidArgumentError(
        absl::StrCat(path, ": has no rows; a line of names and rows of numbers are wanted"));
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

std::string CsvTable::Place(size_t row) const { return absl::StrCat(path_, ":", lines_[row]); }

std::string CsvTable::Place(size_t row, size_t column) const {
  return absl::StrCat(Place(row), ": ", names_[column]);
}

absl::StatusOr<double> CsvTable::Number(size_t row, size_t column) const {
  double value = 0;
  if (!absl::SimpleAtod(Text(row, column), &value) || !std::isfinite(value))
    return absl::InvalidArgumentError(
        absl::StrCat(Place(row, column), " is '", Text(row, column), "', must be a finite number"));
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
