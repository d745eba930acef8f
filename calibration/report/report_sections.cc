#include "calibration/report/report_sections.h"

#include <algorithm>
#include <map>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "calibration/report/report_numbers.h"
#include "calibration/report/report_plots.h"
#include "common/joint_errors/effects/effect_library.h"
#include "common/svg_elements.h"

namespace robostress::calibration {
namespace {

constexpr char kNothing[] = "\u2013";
constexpr char kLeft[] = "<td style=\"text-align:left;white-space:normal\">";
constexpr char kLeftHead[] = "<th style=\"text-align:left\">";

std::string Heading(const std::string& text) { return absl::StrCat("<h3>", text, "</h3>\n"); }

std::string Escaped(const std::vector<std::string>& texts, const char* separator) {
  std::vector<std::string> escaped;
  for (const std::string& text : texts) escaped.push_back(EscapeXml(text));
  return absl::StrJoin(escaped, separator);
}

std::string Parameters(const std::vector<ParameterReport>& parameters) {
  std::vector<std::string> lines;
  for (const ParameterReport& p : parameters) {
    lines.push_back(absl::StrCat(
        "<span style=\"white-space:nowrap\">", EscapeXml(p.name), " = ", ValueText(p.value, p.std),
        p.unit.empty() || p.unit == "1" ? "" : " " + EscapeXml(p.unit),
        p.at_bound ? " <span class=tag>on its bound</span>" : "", "</span>"));
  }
  return absl::StrJoin(lines, "<br>");
}

// The library's equation of a type, or of each of a pair; nothing for what the library lacks.
std::string Equation(const std::string& type) {
  const absl::StatusOr<const EffectInfo*> info = FindEffect(type);
  return info.ok()
             ? absl::StrCat(
                   "<br><small style=\"display:inline-block;white-space:normal;max-width:20em\">",
                   EscapeXml((*info)->equation), "</small>")
             : "";
}

std::string DeclaredSection(const JointReport& joint) {
  if (joint.declared_parameters.empty()) return "";
  std::map<std::string, const ParameterReport*> after;
  for (const ParameterReport& p : joint.after_parameters) after[p.name] = &p;
  const bool added = !joint.effects.empty() && !after.empty();
  std::string html = absl::StrCat(
      Heading("What was declared"), "<div class=scroll><table><tr><th>Parameter</th><th>Unit</th>",
      "<th>Declared model</th>", added ? "<th>With what was added</th>" : "", kLeftHead,
      "</th></tr>\n");
  for (const ParameterReport& p : joint.declared_parameters) {
    const auto found = after.find(p.name);
    const ParameterReport* now = found == after.end() ? nullptr : found->second;
    absl::StrAppend(&html, "<tr><td>", EscapeXml(p.name), "</td><td>", EscapeXml(p.unit),
                    "</td><td>", ValueText(p.value, p.std), "</td>");
    if (added) {
      absl::StrAppend(&html, "<td>", now == nullptr ? kNothing : ValueText(now->value, now->std),
                      "</td>");
    }
    const bool bound = p.at_bound || (now != nullptr && now->at_bound);
    absl::StrAppend(&html, kLeft, p.std > 0 ? "" : "<small>as declared</small>",
                    bound ? " <span class=tag>on its bound</span>" : "", "</td></tr>\n");
  }
  html +=
      "</table></div>\n<p class=note>Values with \u00b1 were fitted (one standard "
      "deviation).</p>\n";
  if (!joint.mimics_exposed.empty()) {
    absl::StrAppend(&html, "<p class=warn><b>Mimics exposed.</b> ",
                    Escaped(joint.mimics_exposed, "; "), ".</p>\n");
  }
  return html;
}

std::string OffSection(const JointReport& joint, const DisplayUnit& unit) {
  const std::pair<const char*, const ErrorReport*> roles[] = {
      {"the logs it was fitted to", &joint.fit},
      {"folds left out in turn", &joint.left_out},
      {"logs held out", &joint.held_out},
      {"an unseen regime", &joint.transfer},
      {"whole runs", &joint.full_run}};
  std::vector<std::string> parts;
  double floor = 0, judged = 0;
  for (const auto& [name, error] : roles) {
    if (!error->present) continue;
    parts.push_back(absl::StrCat(NumberText(unit.factor * error->declared), " ",
                                 EscapeXml(unit.name), " on ", name));
    if (error == &joint.full_run || error == &joint.left_out) continue;
    if (floor > 0 && error != &joint.held_out) continue;
    floor = error->noise_floor, judged = error->declared;
  }
  if (parts.empty()) return "";
  std::string html = absl::StrCat(Heading("How far it is off"), "<p>",
                                  joint.mean_absolute ? "Mean absolute error" : "RMS",
                                  " of its predictions: ", absl::StrJoin(parts, ", "), ".");
  if (floor > 0) {
    absl::StrAppend(&html, " Noise alone makes ", NumberText(unit.factor * floor), " ",
                    EscapeXml(unit.name), ": the model is off by ",
                    judged > 1000 * floor
                        ? "more than 1000"
                        : absl::StrFormat("%.*f", judged < 9.95 * floor ? 1 : 0, judged / floor),
                    " times that.");
  }
  html += "</p>\n";
  if (!joint.effects.empty()) return html;  // the pictures stand under "Before and after"
  html += ErrorPlot(joint, unit);
  for (const ExampleReport& example : joint.examples) html += ExamplePlot(example, false, unit);
  return html;
}

std::string ResidualSection(const JointReport& joint, const DisplayUnit& unit) {
  const bool added = !joint.effects.empty();
  std::string figures;
  for (const StructureCurve& curve : joint.structure) {
    const std::string svg = StructurePlot(curve, added, unit);
    if (svg.empty()) continue;
    absl::StrAppend(&figures, "<figure style=\"margin:0;max-width:345px\">", svg);
    if (curve.limit > 0) {
      const bool beyond = (added ? curve.explained_after : curve.explained_declared) > curve.limit;
      absl::StrAppend(&figures, "<figcaption>holds ", PercentText(curve.explained_declared),
                      " of the residual",
                      added ? absl::StrCat(", after ", PercentText(curve.explained_after)) : "",
                      " (noise alone: up to ", PercentText(curve.limit), ")",
                      beyond ? " <span class=tag>remains</span>" : "", "</figcaption>");
    }
    figures += "</figure>\n";
  }
  const WhitenessReport& white = joint.residual_declared;
  if (figures.empty() && white.limit <= 0 && white.strongest.empty()) return "";
  std::string html = Heading("What the residual looks like");
  if (white.limit > 0 || !white.strongest.empty()) {
    absl::StrAppend(&html, "<p>The declared model's residual is ",
                    white.white ? "white" : "<b>not white</b>");
    if (white.limit > 0) {
      absl::StrAppend(&html, ": its autocorrelation is ", NumberText(white.autocorrelation),
                      ", noise alone stays under ", NumberText(white.limit));
    }
    absl::StrAppend(
        &html, ".",
        white.strongest.empty() ? "" : " Strongest: " + EscapeXml(white.strongest) + ".", "</p>\n");
  }
  if (figures.empty()) return html;
  const auto dot = [](const char* color, const char* name) {
    return absl::StrCat("<span class=dot style=\"background:", color, "\"></span>", name, " ");
  };
  return absl::StrCat(
      html, "<p class=note>Means of the residual over bins, its spectrum against frequency: ",
      dot(kDeclaredColor, "declared model"), added ? dot(kAfterColor, "with what was added") : "",
      "</p>\n<div class=panels>", figures, "</div>\n");
}

std::string CandidateRow(const CandidateReport& c, const JointReport& joint) {
  const bool kept = c.accepted && IsPartOf(c.type, joint);
  return absl::StrCat("<tr", kept ? " style=\"font-weight:600\"" : "", "><td>", EscapeXml(c.type),
                      "</td><td>", PercentText(c.surviving), "</td><td>",
                      PercentText(c.linear_gain), "</td><td>",
                      absl::StrFormat("%.*f", c.p_value >= 0.0995 ? 2 : 3, c.p_value), "</td><td>",
                      c.refitted ? PercentText(c.cv_gain) : kNothing, "</td>", kLeft,
                      kept         ? "accepted"
                      : c.accepted ? "passes every test alone; another model is better"
                                   : EscapeXml(c.reason),
                      "</td></tr>\n");
}

// What came near being accepted stands in sight, the others can be unfolded.
std::string CandidateRows(const RoundReport& round, const JointReport& joint) {
  const std::string head = absl::StrCat(
      "<div class=scroll><table><tr><th>Effect</th><th>Of its own</th><th>Explains</th><th>p</th>"
      "<th>CV gain</th>",
      kLeftHead, "Outcome</th></tr>\n");
  std::string near, others;
  int folded = 0;
  for (const CandidateReport& c : round.candidates) {
    if (c.accepted || c.refitted || c.p_value < 0.1) {
      near += CandidateRow(c, joint);
    } else {
      others += CandidateRow(c, joint);
      ++folded;
    }
  }
  std::string html = near.empty() ? "" : absl::StrCat(head, near, "</table></div>\n");
  if (folded > 0) {
    absl::StrAppend(&html, "<details><summary>", folded,
                    near.empty()  ? ""
                    : folded == 1 ? " other"
                                  : " others",
                    near.empty() ? " effects, none of which explains more than chance" : "",
                    ", with reasons</summary>", head, others, "</table></div></details>\n");
  }
  return html;
}

std::string TriedSection(const JointReport& joint, const DisplayUnit& unit) {
  std::string html;
  for (size_t i = 0; i < joint.rounds.size(); ++i) {
    const RoundReport& round = joint.rounds[i];
    if (round.candidates.empty()) continue;
    absl::StrAppend(&html, "<p>Round ", i + 1, ", on top of ",
                    round.base.empty() ? "the declared model" : Escaped(round.base, " and "),
                    " (cross-validated error ", NumberText(unit.factor * round.cv_error), " ",
                    EscapeXml(unit.name), "):</p>\n",
                    RoundPlot(round, static_cast<int>(i) + 1, joint), CandidateRows(round, joint));
  }
  if (html.empty()) return "";
  return absl::StrCat(
      Heading("What was tried"), html,
      "<p class=note>Of its own: share of the effect's signature that the model so far cannot "
      "imitate. Explains: share of the residual's energy along what is left of it. p: how often "
      "the "
      "best of the whole library does as well on a residual without the effect. CV gain: fall of "
      "the "
      "error on logs or stretches that the refit did not see; only finalists are refitted.</p>\n");
}

std::string AcceptedSection(const JointReport& joint, const DisplayUnit& unit, int n_surrogates) {
  if (joint.effects.empty()) return "";
  std::string html = absl::StrCat(Heading("What was accepted, and why"),
                                  "<div class=scroll><table><tr><th>Effect</th>", kLeftHead,
                                  "Parameters</th><th>CV gain</th>",
                                  "<th>Chance</th><th>Held-out before \u2192 after</th>", kLeftHead,
                                  "Looks the same here</th></tr>\n");
  std::string experiments;
  for (const AddedEffectReport& e : joint.effects) {
    const bool held_out = e.held_out_error_before > 0;
    absl::StrAppend(
        &html, "<tr><td><b>", EscapeXml(e.type), "</b>", Equation(e.type), "</td>", kLeft,
        Parameters(e.parameters), "</td><td>", PercentText(e.cv_gain), "</td><td>",
        PValueText(e.p_value, n_surrogates), "</td><td>",
        held_out ? absl::StrCat(NumberText(unit.factor * e.held_out_error_before), " \u2192 ",
                                NumberText(unit.factor * e.held_out_error_after), " ",
                                EscapeXml(unit.name))
                 : kNothing,
        "</td>", kLeft, e.ambiguous_with.empty() ? "nothing" : Escaped(e.ambiguous_with, "<br>"),
        "</td></tr>\n");
    if (!e.ambiguous_with.empty() && !e.separating_experiment.empty()) {
      absl::StrAppend(&experiments, "<p class=warn><b>", EscapeXml(e.type), "</b> or ",
                      Escaped(e.ambiguous_with, " or "),
                      "? To tell them apart: ", EscapeXml(e.separating_experiment), ".</p>\n");
    }
  }
  return absl::StrCat(html, "</table></div>\n", experiments);
}

std::string BeforeAfterSection(const JointReport& joint, const DisplayUnit& unit) {
  if (joint.effects.empty()) return "";
  std::string html = ErrorPlot(joint, unit);
  if (joint.full_run.present) {
    absl::StrAppend(&html, "<p class=note>Left alone over whole runs: ",
                    NumberText(unit.factor * joint.full_run.declared), " \u2192 ",
                    NumberText(unit.factor * joint.full_run.after), " ", EscapeXml(unit.name),
                    ".</p>\n");
  }
  if (joint.left_out.present) {
    absl::StrAppend(&html, "<p class=note>Folds left out in turn, fitted to the others: ",
                    NumberText(unit.factor * joint.left_out.declared), " \u2192 ",
                    NumberText(unit.factor * joint.left_out.after), " ", EscapeXml(unit.name),
                    ".</p>\n");
  }
  for (const ExampleReport& example : joint.examples) html += ExamplePlot(example, true, unit);
  return html.empty() ? "" : Heading("Before and after") + html;
}

std::string RemainingSection(const JointReport& joint) {
  std::string items;
  const auto item = [&](const std::string& text) {
    absl::StrAppend(&items, "<li>", text, "</li>");
  };
  const WhitenessReport& white = joint.residual_after;
  if (white.limit > 0 || !white.strongest.empty()) {
    item(absl::StrCat("The residual ", joint.effects.empty() ? "" : "after calibration ", "is ",
                      white.white ? "white: noise" : "<b>not white</b>",
                      white.limit > 0
                          ? absl::StrCat(" (autocorrelation ", NumberText(white.autocorrelation),
                                         ", limit ", NumberText(white.limit), ")")
                          : "",
                      white.strongest.empty() || white.white
                          ? "."
                          : "; strongest: " + EscapeXml(white.strongest) + "."));
  }
  for (const std::vector<std::string>& group : joint.groups) {
    item(absl::StrCat("This data does not tell apart: ", Escaped(group, ", "), "."));
  }
  if (!joint.not_testable.empty()) {
    std::vector<std::string> names;
    for (const auto& [type, surviving] : joint.not_testable)
      names.push_back(absl::StrCat(EscapeXml(type), " (", PercentText(surviving), ")"));
    item(
        absl::StrCat("Not testable on this data, because the declared parameters imitate them (in "
                     "brackets what they do not): ",
                     absl::StrJoin(names, ", "), "."));
  }
  if (!joint.next_experiment.text.empty())
    item(absl::StrCat("What to do next: ", EscapeXml(joint.next_experiment.text), "."));
  return items.empty() ? "" : absl::StrCat(Heading("What remains"), "<ul>", items, "</ul>\n");
}

}  // namespace

std::string JointSections(const JointReport& joint, int n_surrogates) {
  const double typical = joint.held_out.present          ? joint.held_out.declared
                         : joint.cross_validated.present ? joint.cross_validated.declared
                                                         : joint.fit.declared;
  const DisplayUnit unit = DisplayUnitFor(joint.unit, typical);
  return absl::StrCat(DeclaredSection(joint), OffSection(joint, unit), ResidualSection(joint, unit),
                      TriedSection(joint, unit), AcceptedSection(joint, unit, n_surrogates),
                      BeforeAfterSection(joint, unit), RemainingSection(joint));
}

}  // namespace robostress::calibration
