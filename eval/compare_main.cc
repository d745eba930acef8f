// robostress-compare: results of several laboratories beside each other.

#include <cstdio>
#include <filesystem>
#include <set>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "eval/report/result_comparison.h"
#include "eval/report/result_export.h"
#include "eval/report/result_file.h"
#include "eval/report/store_comparison.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr char kExamples[] =
    "\nExamples\n"
    "  robostress compare ours.json theirs.json\n"
    "  robostress compare runs/main lab_a.json lab_b.json --out runs/labs\n"
    "  robostress compare runs/before runs/after\n\n"
    "Files are those of `robostress report RUN --export FILE`. Results of other laboratories share "
    "no episode with ours and\n"
    "are compared as independent samples; what is not comparable (other severity, protocol, "
    "version of a scenario, options\n"
    "of a method) is listed and left out. Two run directories are what you changed yourself: tasks "
    "that both have, paired\n"
    "where their episodes pair; other options and weights are compared and noted.\n";

bool IsDirectory(const std::string& path) {
  std::error_code none;
  return fs::is_directory(path, none);
}

// A file's name without folder and ending, or the folder's own.
std::string NameOf(const std::string& path) {
  fs::path name = fs::path(path).lexically_normal();
  if (name.filename().empty()) name = name.parent_path();
  return IsDirectory(path) ? name.filename().string() : name.stem().string();
}

absl::StatusOr<std::vector<NamedResults>> ReadAll(const std::vector<std::string>& paths,
                                                  int replicates) {
  std::vector<NamedResults> labs;
  std::set<std::string> names;
  for (const std::string& path : paths) {
    NamedResults lab;
    lab.name = names.insert(NameOf(path)).second ? NameOf(path) : path;
    if (IsDirectory(path)) {
      RS_ASSIGN_OR_RETURN(const RunData run, JoinRuns({path}));
      RS_ASSIGN_OR_RETURN(lab.file, ExportResults(run, Summarise(run, replicates)));
    } else {
      RS_ASSIGN_OR_RETURN(lab.file, ReadResultFile(path));
    }
    labs.push_back(std::move(lab));
  }
  return labs;
}

absl::Status Compare(const std::vector<std::string>& paths, const std::string& out,
                     int replicates) {
  if (paths.size() == 2 && IsDirectory(paths[0]) && IsDirectory(paths[1]))
    return CompareRunDirectories(paths[0], paths[1], out, replicates);
  RS_ASSIGN_OR_RETURN(const std::vector<NamedResults> labs, ReadAll(paths, replicates));
  RS_ASSIGN_OR_RETURN(const ResultComparison comparison, CompareResults(labs));
  const std::string folder = out.empty() ? "runs/compare" : out;
  RS_RETURN_IF_ERROR(MakeDirectories(folder));
  const TextRows cells = ResultCells(comparison);
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.md", MarkdownTable(cells)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(folder + "/compare.csv", CsvTable(cells)));
  RS_RETURN_IF_ERROR(
      WriteFileAtomically(folder + "/compare.json", ResultComparisonJson(comparison)));
  RS_RETURN_IF_ERROR(
      WriteFileAtomically(folder + "/compare.html", ResultComparisonPage(comparison)));
  std::printf("%s\n  %s\n", AlignedTable(cells).c_str(), ResultComparisonMethod().c_str());
  if (!comparison.refused.empty()) std::printf("\n  Not compared:\n");
  for (const std::string& refused : comparison.refused) std::printf("  - %s\n", refused.c_str());
  if (!comparison.notes.empty()) std::printf("\n  Notes:\n");
  for (const std::string& note : comparison.notes) std::printf("  - %s\n", note.c_str());
  std::printf("%s/compare.html\n", folder.c_str());
  return absl::OkStatus();
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app("Puts results of several laboratories beside each other.",
                           "robostress compare");
  std::vector<std::string> paths;
  std::string out;
  int replicates = 4000;
  app.add_option("FILE", paths, "Exported results, or run directories; the first is the reference")
      ->required();
  app.add_option("--out", out, "Folder for compare.md, .csv, .json, .html (default: runs/compare)");
  app.add_option("--bootstrap", replicates, "Bootstrap replicates, of run directories")
      ->check(robostress::cli::Range(1, 1000000))
      ->capture_default_str();
  app.footer(robostress::kExamples);
  return robostress::RunMain(app, argc, argv,
                             [&] { return robostress::Compare(paths, out, replicates); });
}
