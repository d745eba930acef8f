#include <algorithm>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "calibration/report/report_numbers.h"
#include "calibration/report/report_plots.h"
#include "calibration/report/report_sections.h"
#include "calibration/search/calibration_report.h"
#include "common/html_page.h"
#include "common/svg_elements.h"

namespace robostress::calibration {
namespace {

// What a verdict says, for people who have not read the documentation.
std::string VerdictText(Verdict verdict) {
  switch (verdict) {
    case Verdict::kAttributed:
      return "The effect that the declared model lacked is named";
    case Verdict::kAmbiguous:
      return "An effect is missing; this data leaves a choice of which";
    case Verdict::kReducedNotAttributed:
      return "The error falls, but the mechanism is not established";
    case Verdict::kUnattributed:
      return "Something is missing that no known effect explains";
    case Verdict::kDeclaredSufficient:
      return "The declared model suffices: nothing but noise is left";
    case Verdict::kNotTestable:
      return "This data cannot tell whether something is missing";
  }
  return "";
}

std::string Tile(const std::string& value, const std::string& label) {
  return absl::StrCat("<div class=tile><b>", value, "</b><span>", label, "</span></div>");
}

std::string Badge(Verdict verdict) {
  const bool known = verdict == Verdict::kAttributed || verdict == Verdict::kDeclaredSufficient;
  return absl::StrCat(
      "<span class=tag style=\"",
      known ? "background:#d1fae5;color:#065f46" : "background:#fef3c7;color:#92400e", "\">",
      VerdictName(verdict), "</span>");
}

// The logs that a joint is judged by: held out, else cross-validated, else fitted.
const ErrorReport& Judged(const JointReport& joint) {
  if (joint.held_out.present) return joint.held_out;
  return joint.cross_validated.present ? joint.cross_validated : joint.fit;
}
const char* JudgedName(const JointReport& joint) {
  if (joint.held_out.present) return "held-out logs";
  return joint.cross_validated.present ? "cross-validated" : "the fitted logs themselves";
}

std::string Tiles(const CalibrationReport& report, const JointReport& joint) {
  const ErrorReport& error = Judged(joint);
  const DisplayUnit unit = DisplayUnitFor(joint.unit, error.declared);
  std::string html = "<div class=tiles>";
  const auto text = [&](double value) {
    return absl::StrCat(NumberText(unit.factor * value), " ", EscapeXml(unit.name));
  };
  if (error.present) {
    html += Tile(text(error.declared), absl::StrCat("declared model, RMS on ", JudgedName(joint)));
    if (!joint.effects.empty()) {
      html +=
          Tile(text(error.after),
               absl::StrCat("with what was added (",
                            PercentText(error.declared > 0 ? error.after / error.declared - 1 : 0),
                            ")"));
    }
    if (error.noise_floor > 0)
      html += Tile(text(error.noise_floor), "of noise, which no model can explain");
  }
  if (joint.excess_explained > 0) {
    html += Tile(PercentText(joint.excess_explained),
                 "of the declared model's excess over noise is explained");
  }
  if (!joint.effects.empty())
    html += Tile(absl::StrCat(joint.effects.size()),
                 joint.effects.size() == 1 ? "effect added" : "effects added");
  if (report.n_surrogates > 0)
    html += Tile(absl::StrCat(report.n_surrogates), "surrogates behind every p-value");
  return html + "</div>\n";
}

std::string JointTable(const CalibrationReport& report) {
  std::string html =
      "<div class=scroll><table><tr><th>Joint</th><th>Verdict</th><th>Added</th><th>Declared</th>"
      "<th>After</th><th>Noise</th><th>RMS on</th></tr>\n";
  for (size_t i = 0; i < report.joints.size(); ++i) {
    const JointReport& joint = report.joints[i];
    const ErrorReport& error = Judged(joint);
    const DisplayUnit unit = DisplayUnitFor(joint.unit, error.declared);
    std::vector<std::string> added;
    for (const AddedEffectReport& effect : joint.effects) added.push_back(EscapeXml(effect.type));
    absl::StrAppend(
        &html, "<tr><td><a href=\"#joint", i, "\">", EscapeXml(joint.joint), "</a></td><td>",
        Badge(joint.verdict), "</td><td>", added.empty() ? "\u2013" : absl::StrJoin(added, "<br>"),
        "</td><td>", error.present ? NumberText(unit.factor * error.declared) : "\u2013",
        "</td><td>",
        error.present && !joint.effects.empty() ? NumberText(unit.factor * error.after) : "\u2013",
        "</td><td>",
        error.present && error.noise_floor > 0 ? NumberText(unit.factor * error.noise_floor)
                                               : "\u2013",
        " ", EscapeXml(unit.name), "</td><td>", JudgedName(joint), "</td></tr>\n");
  }
  return html + "</table></div>\n";
}

std::string LogSection(const CalibrationReport& report) {
  if (report.logs.empty()) return "";
  std::string html =
      "<h2 id=logs>The logs</h2>\n<div class=scroll><table><tr><th>File</th><th>Role</th>"
      "<th>Condition</th><th>Rows</th><th>Duration [s]</th><th style=\"text-align:left\">What the "
      "reader found and did</th></tr>\n";
  for (const CalibrationReport::Log& log : report.logs) {
    std::vector<std::string> notes;
    for (const std::string& note : log.notes) notes.push_back(EscapeXml(note));
    absl::StrAppend(&html, "<tr><td>", EscapeXml(FileName(log.file)), "</td><td>",
                    EscapeXml(log.role), "</td><td>",
                    log.condition.empty() ? "\u2013" : EscapeXml(log.condition), "</td><td>",
                    log.rows, "</td><td>", NumberText(log.duration_s),
                    "</td><td style=\"text-align:left;white-space:normal\">",
                    notes.empty() ? "in order" : absl::StrJoin(notes, "<br>"), "</td></tr>\n");
  }
  return html + "</table></div>\n";
}

std::string ModelSection(const CalibrationReport& report) {
  if (report.model_facts.empty()) return "";
  std::string html =
      "<h2 id=model>The model, and what was assumed</h2>\n<div "
      "class=scroll><table><tr><th>Part</th>"
      "<th>Quantity</th><th style=\"text-align:left\">Value</th><th>From</th>"
      "<th style=\"text-align:left\">If that is wrong</th></tr>\n";
  for (const ModelFact& fact : report.model_facts)
    absl::StrAppend(&html, "<tr><td>", EscapeXml(fact.part), "</td><td>", EscapeXml(fact.what),
                    "</td><td style=\"text-align:left;white-space:normal\">", EscapeXml(fact.value),
                    "</td><td>", FactSourceName(fact.source),
                    "</td><td style=\"text-align:left;white-space:normal\">",
                    EscapeXml(fact.remedy), "</td></tr>\n");
  return html + "</table></div>\n";
}

std::string FileSection(const CalibrationReport& report) {
  if (report.model_out.empty() && report.scenario_out.empty()) return "";
  std::string html = "<h2 id=files>What to do with it</h2>\n<ul>";
  if (!report.model_out.empty()) {
    absl::StrAppend(&html, "<li><code>", EscapeXml(report.model_out),
                    "</code>: the rig with what was added; calibrate again with new logs.</li>");
  }
  if (!report.scenario_out.empty()) {
    absl::StrAppend(&html, "<li><code>", EscapeXml(report.scenario_out),
                    "</code>: the same as a scenario of the simulator, in which <code>robostress "
                    "sweep</code> evaluates a policy.</li>");
  }
  return html + "</ul>\n";
}

}  // namespace

std::string ReportHtml(const CalibrationReport& report) {
  const bool one = report.joints.size() == 1;
  std::string html = PageHead(absl::StrCat("Calibration of ", report.rig));
  absl::StrAppend(
      &html, "<header><div class=wrap><h1>", EscapeXml(report.rig), ": ",
      VerdictText(report.verdict), "</h1><p>Calibration against measured logs \u00b7 rig ",
      EscapeXml(FileName(report.rig_file)), " \u00b7 model ", EscapeXml(FileName(report.model)),
      " \u00b7 ", report.logs.size(), report.logs.size() == 1 ? " log" : " logs",
      "</p></div></header>\n<nav><div class=wrap>");
  for (size_t i = 0; i < report.joints.size(); ++i) {
    absl::StrAppend(&html, "<a href=\"#joint", i, "\">", EscapeXml(report.joints[i].joint), "</a>");
  }
  absl::StrAppend(&html, report.model_facts.empty() ? "" : "<a href=\"#model\">Model</a>",
                  report.logs.empty() ? "" : "<a href=\"#logs\">Logs</a>",
                  "</div></nav>\n<main class=wrap>\n<p class=lead>", Badge(report.verdict), " ",
                  EscapeXml(report.because), "</p>\n");
  if (one) html += Tiles(report, report.joints[0]);
  if (report.joints.size() > 1) html += JointTable(report);
  if (!report.evidence.empty()) {
    html += "<h3>Across joints</h3>\n<ul>";
    for (const std::string& line : report.evidence)
      absl::StrAppend(&html, "<li>", EscapeXml(line), "</li>");
    html += "</ul>\n";
  }
  for (size_t i = 0; i < report.joints.size(); ++i) {
    const JointReport& joint = report.joints[i];
    absl::StrAppend(&html, "<section id=joint", i, ">");
    if (!one) {
      absl::StrAppend(&html, "<h2>Joint ", EscapeXml(joint.joint), "</h2><p class=lead>",
                      Badge(joint.verdict), " ", EscapeXml(joint.because), "</p>\n",
                      Tiles(report, joint));
    }
    absl::StrAppend(&html, JointSections(joint, report.n_surrogates), "</section>\n");
  }
  absl::StrAppend(
      &html, FileSection(report), ModelSection(report), LogSection(report),
      "</main><footer><div class=wrap>Written by <code>robostress calibrate</code>",
      report.elapsed_s > 0 ? absl::StrCat(" in ", NumberText(report.elapsed_s), " s") : "",
      ". The same as data: report.json.</div></footer></body></html>\n");
  return html;
}

}  // namespace robostress::calibration
