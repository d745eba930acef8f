#include "eval/report/report.h"

#include <cstdio>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "eval/plan/titles.h"
#include "eval/report/report_page.h"
#include "eval/report/severity_section.h"
#include "eval/report/success_section.h"

namespace robostress {

absl::Status WriteTables(const RunData& run) {
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/episodes.csv", EpisodeTableCsv(run)));
  return WriteFileAtomically(run.dir + "/timings.csv", UnitTimingCsv(run));
}

absl::Status WriteReport(const RunData& run, const ReportOptions& options) {
  const Summary summary = Summarise(run, options.bootstrap_replicates);
  RS_RETURN_IF_ERROR(MakeDirectories(run.dir + "/figures"));
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/table.csv", TableCsv(summary)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/table.md", TableMarkdown(summary)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(run.dir + "/report.json", ReportJson(run, summary)));
  for (const SuccessTable& table : summary.tables) {
    const std::string name = absl::StrCat(table.policy, "-L", table.severity,
                                          table.suite.empty() ? "" : "-" + table.suite);
    RS_RETURN_IF_ERROR(WriteFileAtomically(absl::StrCat(run.dir, "/figures/success-", name, ".svg"),
                                           SuccessPlot(table)));
  }
  for (const std::string& policy : PoliciesWithLevels(summary)) {
    RS_RETURN_IF_ERROR(
        WriteFileAtomically(absl::StrCat(run.dir, "/figures/severity-", policy, ".svg"),
                            SeverityFigure(summary, policy)));
  }
  RS_RETURN_IF_ERROR(
      WriteFileAtomically(run.dir + "/report.html", ReportPage(run, summary, options)));
  if (options.print) {
    std::printf("%s\nreport: %s/report.html\ntables: %s/table.csv %s/report.json %s/episodes.csv\n",
                TerminalTable(run, summary).c_str(), run.dir.c_str(), run.dir.c_str(),
                run.dir.c_str(), run.dir.c_str());
    if (run.sweep_wall_s > 0)
      std::printf("wall time of the sweep: %s\n", FormatDuration(run.sweep_wall_s).c_str());
  }
  return absl::OkStatus();
}

}  // namespace robostress
