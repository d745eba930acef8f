#include "eval/piper_study/piper_study_page.h"

#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <map>
#include <set>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "adapter/method_options.h"
#include "common/atomic_file.h"
#include "common/safetensors.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/paper/filled_table.h"
#include "eval/paper/paper_results.h"
#include "eval/report/report.h"
#include "eval/report/text_table.h"

namespace robostress {
namespace {

constexpr int kReplicates = 4000;

// One line per instruction that has unknown words.
absl::StatusOr<std::string> WordsText(const std::string& weights, const RunData& run) {
  std::set<std::string> told;
  for (const UnitResult& unit : run.units) {
    for (const EpisodeRow& row : unit.episodes) told.insert(row.instruction.value_or(""));
  }
  std::string text;
  for (const std::string& instruction : told) {
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> unknown, UnknownWords(weights, instruction));
    if (!unknown.empty()) {
      absl::StrAppend(&text, "\"", instruction,
                      "\": unknown to the policy: ", absl::StrJoin(unknown, ", "), "\n\n");
    }
  }
  return text;
}

// What each object variant came to: successes of its episodes by policy and method.
std::string VariantsText(const RunData& run) {
  std::map<std::string, std::map<std::string, std::pair<int, int>>> rows;  // words, column: won, n
  std::set<std::string> columns;
  for (const UnitResult& unit : run.units) {
    const SuiteInfo* suite = FindSuite(unit.config.suite);
    if (suite == nullptr || !suite->states_go_on) continue;
    const std::string column =
        absl::StrCat(PolicyLabel(unit.config.policy), " ", unit.config.method->method);
    columns.insert(column);
    for (const EpisodeRow& row : unit.episodes) {
      auto& [won, n] = rows[row.instruction.value_or(absl::StrCat("task ", row.task))][column];
      won += row.success;
      ++n;
    }
  }
  if (rows.empty()) return "";
  TextRows text = {{"Unseen objects"}};
  text[0].insert(text[0].end(), columns.begin(), columns.end());
  for (const auto& [words, cells] : rows) {
    text.push_back({words});
    for (const std::string& column : columns) {
      const auto cell = cells.find(column);
      text.back().push_back(
          cell == cells.end() ? "-" : absl::StrCat(cell->second.first, "/", cell->second.second));
    }
  }
  return absl::StrCat(MarkdownTable(text), "\n");
}

}  // namespace

absl::StatusOr<std::vector<std::string>> UnknownWords(const std::string& weights,
                                                      const std::string& instruction) {
  RS_ASSIGN_OR_RETURN(const SafetensorsFile file, SafetensorsFile::Open(weights));
  const auto found = file.metadata().find("vocabulary");
  if (found == file.metadata().end())
    return absl::InvalidArgumentError(absl::StrCat(weights, ": has no vocabulary of words"));
  const std::set<std::string> known = absl::StrSplit(found->second, ' ', absl::SkipEmpty());
  std::vector<std::string> unknown;
  const auto note = [&](std::string word) {
    while (!word.empty() && word.back() == '-') word.pop_back();
    if (word.empty() || known.count(word) > 0) return;
    if (std::find(unknown.begin(), unknown.end(), word) == unknown.end()) unknown.push_back(word);
  };
  // As the policy splits an instruction: letters, digits and inner hyphens.
  std::string word;
  for (const char c : instruction) {
    if (absl::ascii_isalnum(c) || (c == '-' && !word.empty())) {
      word.push_back(absl::ascii_tolower(c));
    } else {
      note(std::exchange(word, ""));
    }
  }
  note(word);
  return unknown;
}

absl::Status WritePiperPage(const std::vector<PiperTablePlan>& plans, const PaperProtocol& protocol,
                            const RunData& run) {
  ReportOptions options;
  options.bootstrap_replicates = kReplicates;
  options.print = false;
  RS_RETURN_IF_ERROR(WriteReport(run, options));
  std::string page;
  for (const PiperTablePlan& plan : plans) {
    RS_ASSIGN_OR_RETURN(const std::vector<PlannedUnit> units, PaperUnits(plan.grids));
    const FilledTable table =
        FillPaperTable(plan.table, protocol, UnitsOf(run, units), units, kReplicates);
    RS_RETURN_IF_ERROR(WriteFilledTable(table, run.dir + "/tables"));
    absl::StrAppend(&page, FilledMarkdown(table), "\n");
  }
  std::error_code error;
  if (std::filesystem::exists(protocol.base, error)) {
    RS_ASSIGN_OR_RETURN(const std::string words, WordsText(protocol.base, run));
    page += words;
  }
  page += VariantsText(run);
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/report.md", page));
  std::printf("%s\n%s/report.md, report.html, tables/, episodes.csv\n", page.c_str(),
              run.dir.c_str());
  return absl::OkStatus();
}

}  // namespace robostress
