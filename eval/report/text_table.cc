#include "eval/report/text_table.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "common/plain_line.h"

namespace robostress {
namespace {

// Display columns of UTF-8 text.
size_t Columns(const std::string& text) {
  return std::count_if(text.begin(), text.end(),
                       [](char c) { return (static_cast<unsigned char>(c) & 0xC0) != 0x80; });
}

std::string Pad(const std::string& text, size_t columns, bool right) {
  const size_t used = Columns(text);
  const std::string space(columns > used ? columns - used : 0, ' ');
  return right ? space + text : text + space;
}

std::string Quoted(const std::string& text) {
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  return absl::StrCat("\"", absl::StrReplaceAll(text, {{"\"", "\"\""}}), "\"");
}

// Cells hold names of others, and a line break would end a row.
TextRows Lines(TextRows rows) {
  for (auto& row : rows) {
    for (std::string& cell : row) cell = PlainLine(cell);
  }
  return rows;
}

}  // namespace

std::string AlignedTable(const TextRows& cells) {
  const TextRows rows = Lines(cells);
  std::vector<size_t> widths;
  for (const auto& row : rows) {
    widths.resize(std::max(widths.size(), row.size()));
    for (size_t c = 0; c < row.size(); ++c) widths[c] = std::max(widths[c], Columns(row[c]));
  }
  std::string text;
  for (const auto& row : rows) {
    std::string line;
    for (size_t c = 0; c < row.size(); ++c)
      absl::StrAppend(&line, c == 0 ? "  " : "   ", Pad(row[c], widths[c], c > 0));
    absl::StrAppend(&text, line, "\n");
  }
  return text;
}

std::string MarkdownTable(const TextRows& cells) {
  std::string text;
  TextRows rows = Lines(cells);
  for (size_t r = 0; r < rows.size(); ++r) {
    for (std::string& cell : rows[r])
      cell = absl::StrReplaceAll(cell, {{"\\", "\\\\"}, {"|", "\\|"}});
    absl::StrAppend(&text, "| ", absl::StrJoin(rows[r], " | "), " |\n");
    if (r > 0) continue;
    text += "|---|";
    for (size_t c = 1; c < rows[0].size(); ++c) text += "---:|";
    text += "\n";
  }
  return text;
}

std::string CsvTable(const TextRows& rows) {
  std::string text;
  for (const auto& row : rows) {
    for (size_t c = 0; c < row.size(); ++c)
      absl::StrAppend(&text, c == 0 ? "" : ",", Quoted(row[c]));
    text += "\n";
  }
  return text;
}

}  // namespace robostress
