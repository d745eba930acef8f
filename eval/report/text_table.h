#pragma once

#include <string>
#include <vector>

namespace robostress {

// Rows of cells, the heading first; UTF-8.
using TextRows = std::vector<std::vector<std::string>>;

// For a terminal: two spaces before each line, the first column left-aligned, the others right.
// Control characters become spaces, also below.
std::string AlignedTable(const TextRows& rows);
// The same as a Markdown table; '|' and '\\' of cells are escaped.
std::string MarkdownTable(const TextRows& rows);
// The same for a spreadsheet; cells with a comma, a quote or a line break are quoted.
std::string CsvTable(const TextRows& rows);

}  // namespace robostress
