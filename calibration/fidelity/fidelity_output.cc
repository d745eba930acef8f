#include "calibration/fidelity/fidelity_output.h"

#include <cmath>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "calibration/report/report_numbers.h"
#include "common/atomic_file.h"
#include "common/html_page.h"
#include "common/status_macros.h"
#include "common/svg_plot.h"
#include "nlohmann/json.hpp"

namespace robostress::calibration {
namespace {

constexpr const char* kColors[] = {"#0072b2", "#d55e00", "#cc79a7"};
constexpr char kMeasuredColor[] = "#1f2937";

nlohmann::ordered_json Json(const Estimate& estimate) {
  nlohmann::ordered_json json = {{"value_mm", 1e3 * estimate.value}};
  if (std::isfinite(estimate.interval.low))
    json["interval_mm"] = {1e3 * estimate.interval.low, 1e3 * estimate.interval.high};
  return json;
}

std::string Text(const Estimate& estimate) {
  if (!std::isfinite(estimate.interval.low)) return NumberText(1e3 * estimate.value);
  return absl::StrCat(NumberText(1e3 * estimate.value), " [",
                      NumberText(1e3 * estimate.interval.low), ", ",
                      NumberText(1e3 * estimate.interval.high), "]");
}

// In millimetres, over the time of the measured demonstration, with mean -+ standard deviation.
LineSeries Line(const FidelityResult& result, const std::string& name, const char* color,
                const std::vector<Profile>& profiles) {
  LineSeries line{name, color, {}, {}, {}, {}, ""};
  const Profile mean = Mean(profiles), spread = Spread(profiles);
  for (int i = 0; i < kPhases; ++i) {
    line.x.push_back(TimeAtPhase(result.measured.span, i) - result.measured.span.grasp);
    line.y.push_back(1e3 * mean[i]);
    line.low.push_back(1e3 * std::max(0.0, mean[i] - spread[i]));
    line.high.push_back(1e3 * (mean[i] + spread[i]));
  }
  return line;
}

std::string FactorText(double value, bool at_bound) {
  return absl::StrCat(NumberText(value), at_bound ? " (on the bound of the search)" : "");
}

// How the distance of `noise` compares with the fitted model's.
std::string Comparison(const Contender& noise) {
  const Interval& excess = noise.dtw_excess.interval;
  if (!std::isfinite(excess.low)) return "one layout supports no interval";
  if (excess.low > 0) return "farther from the measured profile than the fitted model";
  if (excess.high < 0) return "nearer to the measured profile than the fitted model";
  return "not apart from the fitted model beyond the interval";
}

// What came out, in three sentences.
std::string Conclusion(const FidelityResult& result) {
  const auto rises = [](const Estimate& rise) {
    return rise.interval.low > 0 || (std::isnan(rise.interval.low) && rise.value > 0)
               ? "rises"
               : "does not clearly rise";
  };
  const Contender &model = result.contenders[0], &noise = result.contenders[1];
  return absl::StrCat(
      "Gaussian noise at its stated scale: ", Comparison(noise),
      "; with its scale fitted like the model's factors: ", Comparison(result.contenders[2]),
      ". The deviation ", rises(result.measured_rise), " after the grasp where it is measured, ",
      rises(model.rise), " in the fitted model and ", rises(noise.rise), " under Gaussian noise.");
}

}  // namespace

std::string FidelityJson(const FidelityOptions& options, const FidelityResult& result) {
  nlohmann::ordered_json json;
  json["measured"] = {{"source", result.source},
                      {"simulated", options.measured_dir.empty()},
                      {"loaded_replays", result.measured.loaded.size()},
                      {"grasp_s", result.measured.span.grasp},
                      {"release_s", result.measured.span.release},
                      {"rise", Json(result.measured_rise)},
                      {"dtw_between_replays_mm", 1e3 * result.replay_dtw},
                      {"vertical_mm", 1e3 * result.measured_vertical}};
  if (options.measured_dir.empty()) json["measured"]["payload_kg"] = options.payload_kg;
  const FittedFactors& fit = result.fit;
  json["task"] = {{"suite", options.task.suite},
                  {"task", options.task.task},
                  {"instruction", result.instruction},
                  {"demonstration_layout", options.demonstration_layout},
                  {"first_layout", options.first_layout},
                  {"layouts", options.layouts},
                  {"reference", options.clean_reference ? "clean" : "without_payload"}};
  json["fit"] = {{"w_g", fit.gravity},
                 {"w_c", fit.compliance},
                 {"w_g_at_bound", fit.gravity_at_bound},
                 {"w_c_at_bound", fit.compliance_at_bound},
                 {"rms_mm", 1e3 * fit.rms},
                 {"rms_nominal_mm", 1e3 * fit.rms_nominal},
                 {"replays", fit.replays},
                 {"fitted_noise_sigma", result.fitted_sigma}};
  json["model_vertical_mm"] = 1e3 * result.model_vertical;
  for (const Contender& c : result.contenders) {
    json["contenders"].push_back({{"name", c.name},
                                  {"dtw_per_step", Json(c.dtw)},
                                  {"dtw_total", Json(c.dtw_total)},
                                  {"dtw_minus_models", Json(c.dtw_excess)},
                                  {"rise", Json(c.rise)},
                                  {"replays", c.replays},
                                  {"lost", c.lost}});
  }
  json["seed"] = options.seed;
  json["bootstrap_replicates"] = options.replicates;
  return json.dump(1) + "\n";
}

std::string FidelityCsv(const FidelityResult& result) {
  std::string text =
      "phase,time_from_grasp_s,measured_mean_mm,measured_std_mm,unloaded_mean_mm,"
      "model_demonstration_mm";
  for (size_t c = 0; c < result.contenders.size(); ++c) {
    const char* name = c == 0 ? "model" : c == 1 ? "noise" : "noise_fitted";
    absl::StrAppend(&text, ",", name, "_mean_mm,", name, "_std_mm");
  }
  text += "\n";
  const Profile spread = Spread(result.measured.loaded), unloaded = Mean(result.measured.unloaded);
  std::vector<Profile> spreads;
  for (const Contender& c : result.contenders) spreads.push_back(Spread(c.profiles));
  for (int i = 0; i < kPhases; ++i) {
    absl::StrAppendFormat(&text, "%.3f,%.3f,%.4f,%.4f,%.4f,%.4f", PhaseAt(i),
                          TimeAtPhase(result.measured.span, i) - result.measured.span.grasp,
                          1e3 * result.measured_mean[i], 1e3 * spread[i], 1e3 * unloaded[i],
                          1e3 * result.model_demonstration[i]);
    for (size_t c = 0; c < result.contenders.size(); ++c)
      absl::StrAppendFormat(&text, ",%.4f,%.4f", 1e3 * result.contenders[c].mean[i],
                            1e3 * spreads[c][i]);
    text += "\n";
  }
  return text;
}

std::string FidelitySvg(const FidelityResult& result) {
  std::vector<LineSeries> lines = {
      Line(result, "measured", kMeasuredColor, result.measured.loaded)};
  PlotSheetOptions sheet;
  sheet.title = "End-effector deviation with a payload";
  sheet.legend = {{"measured (mean, one standard deviation)", kMeasuredColor}};
  for (size_t c = 0; c < result.contenders.size(); ++c) {
    lines.push_back(
        Line(result, result.contenders[c].name, kColors[c], result.contenders[c].profiles));
    if (c == 2) lines.back().dash = "5 3";
    sheet.legend.emplace_back(result.contenders[c].name, kColors[c]);
  }
  sheet.plot_width = 860;
  sheet.plot_height = 360;
  LinePlotOptions options;
  options.x_label = "time from the grasp, in the measured demonstration's pace [s]";
  options.y_label = "deviation [mm]";
  options.width = sheet.plot_width;
  options.height = sheet.plot_height;
  options.y_min = 0;
  options.fractional_x_ticks = true;
  options.vertical_marks = {0};
  options.labels = {{0, "grasp"}};
  return PlotSheet({LinePlot(lines, options)}, sheet);
}

std::string FidelityHtml(const FidelityOptions& options, const FidelityResult& result) {
  const FittedFactors& fit = result.fit;
  std::string html = PageHead("Fidelity of Heavy Payload");
  absl::StrAppend(
      &html, "<header><div class=wrap><h1>Heavy Payload against a payload</h1><p>measured: ",
      EscapeXml(result.source), "</p></div></header>\n<main class=wrap>\n<p class=lead>",
      Conclusion(result), "</p>\n", FidelitySvg(result),
      "<div class=scroll><table><tr><th>Other layouts against the measured mean</th>"
      "<th>DTW [mm per step]</th><th>DTW minus the model's</th><th>Rise after the grasp "
      "[mm]</th><th>Object lost</th></tr>\n");
  for (const Contender& c : result.contenders) {
    absl::StrAppend(&html, "<tr><td>", EscapeXml(c.name), "</td><td>", Text(c.dtw), "</td><td>",
                    &c == &result.contenders[0] ? "\u2013" : Text(c.dtw_excess), "</td><td>",
                    Text(c.rise), "</td><td>", c.lost, " of ", c.replays, "</td></tr>\n");
  }
  absl::StrAppend(&html, "<tr class=avg><td>measured (a replay against the others)</td><td>",
                  result.replay_dtw > 0 ? NumberText(1e3 * result.replay_dtw) : "\u2013",
                  "</td><td>\u2013</td><td>", Text(result.measured_rise),
                  "</td><td>\u2013</td></tr>\n</table></div>\n");
  absl::StrAppend(
      &html, "<p>Fitted to the demonstration: w<sup>g</sup> = ",
      FactorText(fit.gravity, fit.gravity_at_bound),
      ", w<sup>c</sup> = ", FactorText(fit.compliance, fit.compliance_at_bound),
      "; RMS to the measured mean ", NumberText(1e3 * fit.rms), " mm from ",
      NumberText(1e3 * fit.rms_nominal), " mm without a payload. During the carry the tool is ",
      NumberText(1e3 * result.measured_vertical), " mm above its unloaded height where measured, ",
      NumberText(1e3 * result.model_vertical),
      " mm in the model.</p>\n<p class=note>Task: ", EscapeXml(result.instruction), ", layouts ",
      options.first_layout, " to ", options.first_layout + options.layouts - 1,
      "; deviations are from the replay ",
      options.clean_reference ? "without any joint error" : "of the same arm without the payload",
      ". Profiles are laid over each other by phase: start, grasp, release. Intervals: 95 %, "
      "bootstrap over layouts and measured replays, ",
      options.replicates, " replicates.",
      options.measured_dir.empty()
          ? " The measured side is simulated: a true mass in the gripper that the controller does "
            "not know; replays differ by 0.2 mrad at the joints and 1 mm of the object's place."
          : "",
      "</p>\n</main></body></html>\n");
  return html;
}

std::string FidelityTable(const FidelityResult& result) {
  const FittedFactors& fit = result.fit;
  std::string text = absl::StrFormat(
      "measured: %s\nfitted to the demonstration: w_g = %s, w_c = %s; RMS %.2f mm (without a "
      "payload %.2f)\n\n%-30s %-24s %-24s %-24s %s\n",
      result.source, FactorText(fit.gravity, fit.gravity_at_bound),
      FactorText(fit.compliance, fit.compliance_at_bound), 1e3 * fit.rms, 1e3 * fit.rms_nominal,
      "other layouts", "DTW [mm per step]", "minus the model's", "rise after grasp [mm]", "lost");
  for (const Contender& c : result.contenders) {
    absl::StrAppendFormat(&text, "%-30s %-24s %-24s %-24s %d of %d\n", c.name, Text(c.dtw),
                          &c == &result.contenders[0] ? "-" : Text(c.dtw_excess), Text(c.rise),
                          c.lost, c.replays);
  }
  absl::StrAppendFormat(&text, "%-30s %-24s %-24s %s\n\n%s\n", "measured, replay to replay",
                        NumberText(1e3 * result.replay_dtw), "-", Text(result.measured_rise),
                        Conclusion(result));
  return text;
}

absl::Status WriteFidelity(const std::string& dir, const FidelityOptions& options,
                           const FidelityResult& result) {
  RS_RETURN_IF_ERROR(MakeDirectories(dir));
  if (options.measured_dir.empty()) {
    RS_RETURN_IF_ERROR(MakeDirectories(dir + "/measured"));
    RS_RETURN_IF_ERROR(
        WriteFileAtomically(dir + "/measured/replays.csv", WriteMeasuredReplays(result.replays)));
  }
  RS_RETURN_IF_ERROR(WriteFileAtomically(dir + "/profiles.csv", FidelityCsv(result)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(dir + "/fidelity.svg", FidelitySvg(result)));
  RS_RETURN_IF_ERROR(WriteFileAtomically(dir + "/fidelity.html", FidelityHtml(options, result)));
  return WriteFileAtomically(dir + "/fidelity.json", FidelityJson(options, result));
}

}  // namespace robostress::calibration
