#include "eval/report/report_page.h"

#include <algorithm>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "adapter/methods.h"
#include "common/html_page.h"
#include "common/svg_plot.h"
#include "eval/plan/titles.h"
#include "eval/report/adaptation_section.h"
#include "eval/report/html_numbers.h"
#include "eval/report/report.h"
#include "eval/report/report_appendix.h"
#include "eval/report/severity_section.h"
#include "eval/report/statistics_section.h"
#include "eval/report/success_section.h"
#include "eval/store/played_alike.h"
#include "eval/store/served_policies.h"

namespace robostress {
namespace {

// The first names, and how many there are when there are more.
std::string FirstOf(std::vector<std::string> names, size_t count) {
  const size_t all = names.size();
  names.resize(std::min(all, count));
  return absl::StrCat(absl::StrJoin(names, ", "), all > count ? absl::StrCat(" ... ", all) : "");
}

std::string UpdatesHtml(bool adapts, int updates) {
  const std::string text = UpdatesText(adapts, updates);
  if (text == "not adapted") return "<span class=tag>not adapted</span>";
  return text == "-" ? "\u2013" : text;
}

const SuccessTable* MainTable(const Summary& summary) {
  const SuccessTable* best = nullptr;
  for (const SuccessTable& table : summary.tables) {
    if (!table.suite.empty()) continue;
    if (best == nullptr || table.methods.size() > best->methods.size() ||
        (table.methods.size() == best->methods.size() && table.severity > best->severity))
      best = &table;
  }
  return best;
}

// What the main table says, in words that claim no more than it shows.
std::string Headline(const SuccessTable& table) {
  const auto base = table.averages.find("base");
  if (base == table.averages.end() || !std::isfinite(base->second.success.estimate)) {
    return absl::StrCat("<p class=lead>",
                        table.averages.empty()
                            ? "This run has no scenario with errors"
                            : "The base policy was not played in every scenario of this run",
                        ", so there is nothing to compare yet.</p>");
  }
  std::string text = "<p class=lead>";
  const Cell* clean = nullptr;
  for (const ScenarioRow& row : table.rows) {
    if (row.scenario == "clean" && row.cells.count("base")) clean = &row.cells.at("base");
  }
  if (clean != nullptr) {
    absl::StrAppend(&text, "The unadapted policy succeeds in ", Percent(clean->rate()),
                    " % of the episodes without execution errors and in ");
  } else {
    text += "The unadapted policy succeeds in ";
  }
  absl::StrAppend(&text, Percent(base->second.success.estimate), " % on average under them. ");
  for (const std::string method : {"ours", "ours_intent", "ours_nominal"}) {
    const auto average = table.averages.find(method);
    if (average == table.averages.end() || !average->second.contrasts.versus_base) continue;
    const Comparison& c = *average->second.contrasts.versus_base;
    const Interval& interval = c.difference.interval;
    absl::StrAppend(
        &text, "<b>", MethodTitle(method), "</b> (",
        average->second.updates == 0 ? "not adapted"
                                     : absl::StrCat(average->second.updates, " updates"),
        ") reaches ", Percent(average->second.success.estimate),
        " %: ", Signed(c.difference.estimate), " points ", IntervalHtml(interval, true), ". ");
    if (!std::isfinite(interval.low)) {
      text += "One cluster supports no interval. ";
    } else if (interval.low <= 0 && interval.high >= 0) {
      text += "The interval includes zero: this run does not show a difference. ";
    } else {
      absl::StrAppend(&text, "The interval excludes zero: a ",
                      c.difference.estimate > 0 ? "gain" : "loss", " on these episodes. ");
    }
  }
  text += "</p>\n";
  if (clean != nullptr && clean->rate() < 0.7) {
    absl::StrAppend(&text, "<p class=warn>Success without errors is ", Percent(clean->rate()),
                    " %, under 70 %: a policy this weak supports no claim about adaptation.</p>\n");
  }
  return text;
}

std::string Tile(const std::string& value, const std::string& label) {
  return absl::StrCat("<div class=tile><b>", value, "</b><span>", label, "</span></div>");
}

std::string Tiles(const RunData& run, const Summary& summary, const SuccessTable& table) {
  std::string html = "<div class=tiles>";
  for (const ScenarioRow& row : table.rows) {
    if (row.scenario == "clean" && row.cells.count("base"))
      html += Tile(Percent(row.cells.at("base").rate()) + " %", "base, Clean");
  }
  for (const std::string& method : table.methods) {
    if (html.size() > 700 || !table.averages.count(method)) break;
    if (table.averages.at(method).n == 0) continue;
    html += Tile(Percent(table.averages.at(method).success.estimate) + " %",
                 absl::StrCat(MethodTitle(method), ", average under errors"));
  }
  const auto ours = table.averages.find("ours");
  if (ours != table.averages.end() && ours->second.contrasts.versus_base) {
    html += Tile(
        Signed(ours->second.contrasts.versus_base->difference.estimate),
        absl::StrCat("points, ours against base<br>",
                     IntervalHtml(ours->second.contrasts.versus_base->difference.interval, true)));
    html += Tile(UpdatesHtml(ours->second.adapts, ours->second.updates), "updates applied, ours");
  }
  html += Tile(absl::StrCat(summary.episodes),
               absl::StrCat("episodes in ", run.units.size(), " units"));
  if (run.sweep_wall_s > 0)
    html += Tile(FormatDuration(run.sweep_wall_s), "wall time of the sweep");
  return html + "</div>\n";
}

}  // namespace

std::string ReportPage(const RunData& run, const Summary& summary, const ReportOptions& options) {
  const SuccessTable& main = *MainTable(summary);
  const std::string videos = VideoSection(run, options);
  const std::string severity = SeveritySection(summary), statistics = StatisticsSection(summary);
  std::string html = PageHead("RoboStress report");
  absl::StrAppend(&html, "<header><div class=wrap><h1>RoboStress: policy ", EscapeXml(main.policy),
                  " under joint-level execution errors</h1><p>Suite",
                  main.title.find(',') == std::string::npos ? " " : "s ", EscapeXml(main.title),
                  " \u00b7 severity L", main.severity, " \u00b7 ", summary.episodes,
                  " episodes \u00b7 ", run.units.size(), " units</p></div></header>\n");
  absl::StrAppend(&html, "<nav><div class=wrap><a href=\"#success\">Success</a>",
                  statistics.empty() ? "" : "<a href=\"#statistics\">Statistics</a>",
                  severity.empty() ? "" : "<a href=\"#severity\">Severity</a>",
                  "<a href=\"#residual\">Residuals</a><a href=\"#adaptation\">Adaptation</a>",
                  videos.empty() ? "" : "<a href=\"#videos\">Rollouts</a>",
                  options.training.empty() ? "" : "<a href=\"#training\">Training</a>",
                  "<a href=\"#setup\">Setup</a><a href=\"#limits\">Limits</a></div></nav>\n<main "
                  "class=wrap>\n");
  // The headline is of `ours`; a run with more methods begins with what came out of each.
  const std::string came_out = main.methods.size() > 2 ? Conclusion(main) : "";
  absl::StrAppend(&html,
                  came_out.empty() ? Headline(main)
                                   : absl::StrCat("<p class=lead>", EscapeXml(came_out), "</p>\n"),
                  Tiles(run, summary, main));
  if (const std::string note = MixedMachinesNote(run); !note.empty())
    absl::StrAppend(&html, "<p class=warn>", EscapeXml(note), ".</p>\n");
  for (const std::string& note :
       {UnlikeUnitsNote(run), LiberoFilesNote(run), UnpairedNoiseNote(run), LateAnswersNote(run),
        ClippedCommandsNote(run)})
    if (!note.empty()) absl::StrAppend(&html, "<p class=warn>", EscapeXml(note), "</p>\n");
  for (const std::string& note : ServerNotes(run))
    absl::StrAppend(&html, "<p class=warn>", EscapeXml(note), "</p>\n");
  if (!run.unfinished.empty()) {
    absl::StrAppend(&html, "<p class=warn>", run.unfinished.size(),
                    " unfinished units are left out of every number on this page: ",
                    EscapeXml(FirstOf(run.unfinished, 50)), ".</p>\n");
  }
  absl::StrAppend(&html, SuccessSection(summary), statistics, severity, ResidualSection(summary),
                  AdaptationSection(summary));
  absl::StrAppend(&html, videos, options.training.empty() ? "" : TrainingSection(options.training),
                  SetupSection(run), LimitsSection(run, summary, main));
  absl::StrAppend(&html, "</main><footer><div class=wrap>Written by <code>robostress report ",
                  EscapeXml(run.dir),
                  "</code> from the recorded episodes. "
                  "The same numbers as data: table.csv, report.json, "
                  "episodes.csv.</div></footer></body></html>\n");
  return html;
}

}  // namespace robostress
