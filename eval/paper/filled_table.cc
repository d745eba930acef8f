#include "eval/paper/filled_table.h"

#include <algorithm>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/html_page.h"
#include "common/status_macros.h"
#include "common/svg_plot.h"
#include "eval/plan/titles.h"
#include "eval/report/html_numbers.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

std::string ValueText(const FilledCell& cell, int decimals) {
  return cell.value ? absl::StrFormat("%.*f", decimals, *cell.value) : "-";
}

std::string IntervalText(const FilledCell& cell, int decimals) {
  const int d = decimals == 1 ? 0 : decimals;
  return std::isfinite(cell.interval.low)
             ? absl::StrFormat("[%.*f, %.*f]", d, cell.interval.low, d, cell.interval.high)
             : "";
}

std::string CountText(const FilledRow& row) {
  CountRange counts;
  for (const FilledCell& cell : row.cells) counts.Add(cell.n);
  return counts.Text();
}

TextRows Rows(const FilledTable& table, bool markdown) {
  TextRows rows = {{table.row_heading, "n"}};
  for (const FilledGroup& group : table.groups) {
    for (const std::string& column : group.columns)
      rows[0].push_back(absl::StrCat(group.title, ": ", column));
  }
  for (const FilledRow& row : table.rows) {
    std::vector<std::string> cells = {row.title, CountText(row)};
    for (const FilledCell& cell : row.cells) {
      std::string text = ValueText(cell, table.decimals);
      if (cell.best && markdown) text = absl::StrCat("**", text, "**");
      const std::string interval = IntervalText(cell, table.decimals);
      cells.push_back(absl::StrCat(text, interval.empty() ? "" : " ", interval));
    }
    rows.push_back(cells);
  }
  return rows;
}

std::string HtmlCell(const FilledCell& cell, bool published, int decimals) {
  std::string text = cell.value ? ValueText(cell, decimals) : "\u2013";
  if (cell.best) text = absl::StrCat("<b>", text, "</b>");
  std::string html = absl::StrCat(published ? "<td class=paper>" : "<td>", text);
  const std::string interval = IntervalText(cell, decimals);
  if (!interval.empty()) absl::StrAppend(&html, "<span class=ci>", Minus(interval), "</span>");
  if (!cell.note.empty())
    absl::StrAppend(&html, "<span class=ci>", EscapeXml(cell.note), "</span>");
  return html + "</td>";
}

std::string HtmlTable(const FilledTable& table) {
  std::string head = "<tr><th></th><th></th>", columns;
  for (const FilledGroup& group : table.groups) {
    absl::StrAppend(&head, "<th style=\"text-align:center\" colspan=", group.columns.size(),
                    group.published ? " class=paper>paper, " : ">", EscapeXml(group.title),
                    "</th>");
    for (const std::string& column : group.columns)
      absl::StrAppend(&columns, group.published ? "<th class=paper>" : "<th>", EscapeXml(column),
                      "</th>");
  }
  std::string html =
      absl::StrCat("<div class=scroll><table>", head, "</tr>\n<tr><th>",
                   EscapeXml(table.row_heading), "</th><th>n</th>", columns, "</tr>\n");
  for (const FilledRow& row : table.rows) {
    absl::StrAppend(&html, row.average ? "<tr class=avg><td>" : "<tr><td>", EscapeXml(row.title),
                    "</td><td>", CountText(row), "</td>");
    size_t next = 0;
    for (const FilledGroup& group : table.groups) {
      for (size_t c = 0; c < group.columns.size(); ++c)
        html += HtmlCell(row.cells[next++], group.published, table.decimals);
    }
    html += "</tr>\n";
  }
  return html + "</table></div>\n";
}

std::string HtmlRows(const TextRows& rows) {
  std::string html = "<div class=scroll><table>";
  for (size_t r = 0; r < rows.size(); ++r) {
    html += "<tr>";
    for (const std::string& cell : rows[r])
      absl::StrAppend(&html, r == 0 ? "<th>" : "<td>",
                      EscapeXml(r == 0 || &cell == &rows[r].front() ? cell : Minus(cell)),
                      r == 0 ? "</th>" : "</td>");
    html += "</tr>\n";
  }
  return html + "</table></div>\n";
}

std::string CsvText(const std::string& text) {
  if (text.find_first_of(",\"\n") == std::string::npos) return text;
  return absl::StrCat("\"", absl::StrReplaceAll(text, {{"\"", "\"\""}}), "\"");
}

// Calls use(row, group, column's title, cell).
template <class Use>
void ForEachCell(const FilledTable& table, const Use& use) {
  for (const FilledRow& row : table.rows) {
    size_t next = 0;
    for (const FilledGroup& group : table.groups) {
      for (const std::string& column : group.columns) use(row, group, column, row.cells[next++]);
    }
  }
}

}  // namespace

void MarkBest(FilledTable& table) {
  for (FilledRow& row : table.rows) {
    size_t first = 0;
    for (const FilledGroup& group : table.groups) {
      const size_t end = first + group.columns.size();
      double best = -std::numeric_limits<double>::infinity();
      for (size_t c = first; c < end; ++c) best = std::max(best, row.cells[c].value.value_or(best));
      for (size_t c = first; c < end && group.columns.size() > 1; ++c)
        row.cells[c].best = row.cells[c].value == best;
      first = end;
    }
  }
}

std::string FilledText(const FilledTable& table) {
  std::string text = absl::StrCat("\n", table.name, " (", table.label, "): ", table.caption, "\n",
                                  AlignedTable(Rows(table, false)));
  if (!table.differences.empty()) absl::StrAppend(&text, "\n", AlignedTable(table.differences));
  for (const std::string& note : table.notes) absl::StrAppend(&text, "  - ", note, "\n");
  return text;
}

std::string FilledMarkdown(const FilledTable& table) {
  std::string text =
      absl::StrCat(table.caption, " (", table.label, ").\n\n", MarkdownTable(Rows(table, true)));
  if (!table.differences.empty()) absl::StrAppend(&text, "\n", MarkdownTable(table.differences));
  text += "\n";
  for (const std::string& note : table.notes) absl::StrAppend(&text, "- ", note, "\n");
  return text;
}

std::string FilledCsv(const FilledTable& table) {
  std::string csv = "table,row,group,column,published,value,low,high,n,note\n";
  const auto number = [](double value) {
    return std::isfinite(value) ? absl::StrFormat("%.6g", value) : "";
  };
  ForEachCell(table, [&](const FilledRow& row, const FilledGroup& group, const std::string& column,
                         const FilledCell& cell) {
    absl::StrAppend(&csv, table.name, ",", CsvText(row.title), ",", CsvText(group.title), ",",
                    CsvText(column), ",", group.published ? 1 : 0, ",",
                    cell.value ? number(*cell.value) : "", ",", number(cell.interval.low), ",",
                    number(cell.interval.high), ",", group.published ? "" : absl::StrCat(cell.n),
                    ",", CsvText(cell.note), "\n");
  });
  return csv;
}

std::string FilledJson(const FilledTable& table) {
  nlohmann::json cells = nlohmann::json::array();
  ForEachCell(table, [&](const FilledRow& row, const FilledGroup& group, const std::string& column,
                         const FilledCell& cell) {
    nlohmann::json entry = {{"row", row.title},
                            {"group", group.title},
                            {"column", column},
                            {"published", group.published}};
    entry["value"] = cell.value ? nlohmann::json(*cell.value) : nlohmann::json(nullptr);
    if (std::isfinite(cell.interval.low))
      entry["interval"] = {cell.interval.low, cell.interval.high};
    if (!group.published) entry["n"] = cell.n;
    if (!cell.note.empty()) entry["note"] = cell.note;
    cells.push_back(entry);
  });
  const nlohmann::json json = {{"table", table.name},
                               {"label", table.label},
                               {"caption", table.caption},
                               {"cells", cells},
                               {"differences", table.differences},
                               {"notes", table.notes}};
  return json.dump(1) + "\n";
}

std::string FilledPage(const FilledTable& table, const std::string& videos) {
  std::string html = PageHead(absl::StrCat("RoboStress: ", table.name));
  // Wide tables: ours, two backbones of the paper, controls.
  absl::StrAppend(
      &html,
      "<style>.wrap{max-width:1560px}th,td{padding:5px 8px}tr.avg td{font-weight:400}</style>\n"
      "<header><div class=wrap><h1>",
      EscapeXml(table.caption), "</h1><p>", EscapeXml(table.label),
      " of the paper; our numbers beside the published ones</p></div></header>\n<main "
      "class=wrap>\n<h2>The table</h2>\n",
      HtmlTable(table), "<p class=note>", EscapeXml(table.reading), "</p>\n");
  if (!table.differences.empty())
    absl::StrAppend(&html, "<h2>Differences on the same episodes</h2>\n",
                    HtmlRows(table.differences));
  if (!table.figure.empty())
    absl::StrAppend(&html, "<h2>Figure</h2>\n<div class=scroll>", table.figure, "</div>\n");
  absl::StrAppend(&html, videos, "<h2>How this differs from the paper</h2>\n<ul>\n");
  for (const std::string& note : table.notes)
    absl::StrAppend(&html, "<li>", EscapeXml(note), "</li>\n");
  return html + "</ul>\n</main></body></html>\n";
}

absl::Status WriteFilledTable(const FilledTable& table, const std::string& folder,
                              const std::string& videos) {
  const std::string stem = absl::StrCat(folder, "/", table.name);
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  RS_RETURN_IF_ERROR(WriteFileAtomically(stem + ".csv", FilledCsv(table)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(stem + ".md", FilledMarkdown(table)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(stem + ".json", FilledJson(table)));
  return WriteFileAtomically(stem + ".html", FilledPage(table, videos));
}

}  // namespace robostress
