#include "server/pages/live_page.h"

#include <algorithm>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "adapter/method_options.h"
#include "common/html_page.h"
#include "common/statistics.h"
#include "common/svg_elements.h"
#include "common/svg_plot.h"

namespace robostress {
namespace {

// Sessions with plots and images; the others are rows of the table.
constexpr size_t kShownInFull = 12;

constexpr double kInUse_s = 60;  // since a session's last message

constexpr int kPlotWidth = 340;     // three beside each other
constexpr size_t kMostPoints = 60;  // of one line of residuals; more cannot be told apart

// Okabe and Ito's colours: told apart by colour-blind eyes.
constexpr const char* kColours[] = {"#0072b2", "#e69f00", "#009e73", "#d55e00",
                                    "#cc79a7", "#56b4e9", "#8a8a8a"};

std::string Tile(const std::string& value, const std::string& label) {
  return absl::StrCat("<div class=tile><b>", EscapeXml(value), "</b><span>", EscapeXml(label),
                      "</span></div>");
}

constexpr char kNothing[] = "\u2013";  // where there is no number yet

std::string Latency(const Histogram& histogram, double quantile, bool any) {
  if (!any) return kNothing;
  const double ms = 1e3 * QuantileOf(histogram, quantile);
  return ms < 1000 ? absl::StrFormat("%.3g ms", ms) : absl::StrFormat("%.0f ms", ms);
}

std::string UrlEscape(const std::string& text) {
  std::string escaped;
  for (const char c : text) {
    const bool plain = (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') ||
                       c == '-' || c == '_' || c == '.';
    escaped += plain ? std::string(1, c) : absl::StrFormat("%%%02X", static_cast<unsigned char>(c));
  }
  return escaped;
}

std::string Name(const SessionSpec& spec) {
  return absl::StrCat(spec.robot, " · ", spec.suite, " · ", spec.scenario, " L", spec.severity,
                      " · ", spec.policy, " · ", spec.method->method, " · seed ", spec.seed);
}

// One line an axis; a point is the mean of `together` chunks.
std::string ResidualPlot(const Telemetry::View& view) {
  std::vector<LineSeries> series;
  const Eigen::Index axes = view.residuals.empty() ? 0 : view.residuals.back().mean_abs.size();
  const size_t together = (view.residuals.size() + kMostPoints - 1) / kMostPoints;
  for (Eigen::Index i = 0; i < axes; ++i) {
    LineSeries line;
    line.name = ResidualAxis(view.figures.spec, static_cast<int>(i));
    line.color = kColours[static_cast<size_t>(i) % std::size(kColours)];
    double sum = 0;
    size_t summed = 0;
    for (const auto& point : view.residuals) {
      if (point.mean_abs.size() != axes) continue;
      sum += point.mean_abs[i];
      const bool last = &point == &view.residuals.back();
      if (++summed < together && !last) continue;
      line.x.push_back(static_cast<double>(point.sequence));
      line.y.push_back(sum / static_cast<double>(summed));
      sum = 0;
      summed = 0;
    }
    series.push_back(std::move(line));
  }
  LinePlotOptions options;
  options.title = ActsInJointSpace(view.figures.spec) ? "mean |residual| [rad]"
                                                      : "mean |residual| [action units]";
  options.x_label = "executed chunk";
  if (together > 1) absl::StrAppend(&options.x_label, ", a point is the mean of ", together);
  options.y_min = 0;
  options.width = kPlotWidth;
  return LinePlot(series, options);
}

std::string DriftPlot(const Telemetry::View& view) {
  LineSeries line;
  line.name = "distance";
  line.color = kColours[0];
  for (const auto& point : view.drift) {
    line.x.push_back(static_cast<double>(point.version));
    line.y.push_back(point.distance);
  }
  LinePlotOptions options;
  options.title = "adapter's distance from its start";
  options.x_label = "version";
  options.y_min = 0;
  options.width = kPlotWidth;
  options.dots = line.x.size() < 2;
  return LinePlot({line}, options);
}

std::string LatencyPlot(const Telemetry::View& view) {
  LineSeries line;
  line.name = "prediction";
  line.color = kColours[2];
  for (size_t i = 0; i < view.latencies_s.size(); ++i) {
    line.x.push_back(static_cast<double>(i));
    line.y.push_back(1e3 * view.latencies_s[i]);
  }
  LinePlotOptions options;
  options.title = "prediction [ms]";
  options.x_label = absl::StrCat("the last ", view.latencies_s.size());
  options.y_min = 0;
  options.width = kPlotWidth;
  return LinePlot({line}, options);
}

std::string Legend(const Telemetry::View& view) {
  std::string html;
  const Eigen::Index axes = view.residuals.empty() ? 0 : view.residuals.back().mean_abs.size();
  for (Eigen::Index i = 0; i < axes; ++i) {
    absl::StrAppend(&html, "<span><span class=dot style=\"background:",
                    kColours[static_cast<size_t>(i) % std::size(kColours)], "\"></span>",
                    ResidualAxis(view.figures.spec, static_cast<int>(i)), "</span> ");
  }
  return html;
}

std::string Row(const Telemetry::View& view) {
  const SessionFigures& f = view.figures;
  const auto if_learned = [&f](double value) {
    return f.updates_applied > 0 ? absl::StrFormat("%.3g", value) : kNothing;
  };
  std::vector<double> latencies = view.latencies_s;
  std::sort(latencies.begin(), latencies.end());
  return absl::StrCat(
      "<tr><td style=\"white-space:normal\">", EscapeXml(f.id), "<br><small>",
      EscapeXml(Name(f.spec)), "</small>",
      f.error.empty() ? "" : absl::StrCat("<br><span class=tag>", EscapeXml(f.error), "</span>"),
      "</td><td>", f.open ? "open" : "on disk", absl::StrFormat(", %.0f s", f.idle_s), "</td><td>",
      f.predictions, "</td><td>", f.feedback_sequence, "</td><td>", f.updates_applied, "</td><td>",
      f.updates_refused + f.updates_guarded, "</td><td>", f.duplicates, "</td><td>",
      if_learned(f.adapter_distance), "</td><td>", if_learned(f.last_loss), "</td><td>",
      latencies.empty() ? kNothing
                        : absl::StrFormat("%.1f / %.1f", 1e3 * Quantile(latencies, 0.5),
                                          1e3 * Quantile(latencies, 0.99)),
      "</td></tr>\n");
}

std::string Session(const Telemetry::View& view) {
  std::string html = absl::StrCat("<h3>", EscapeXml(view.figures.id), "</h3><p class=note>",
                                  EscapeXml(Name(view.figures.spec)), "</p>");
  if (!view.cameras.empty()) {
    absl::StrAppend(&html, "<div class=pair><div class=row>");
    for (const std::string& camera : view.cameras) {
      absl::StrAppend(&html, "<figure><img alt=\"", EscapeXml(camera),
                      "\" src=\"/image?session=", UrlEscape(view.figures.id),
                      "&amp;camera=", UrlEscape(camera), "&amp;n=", view.image_count,
                      "\"><figcaption>", EscapeXml(camera), "</figcaption></figure>");
    }
    absl::StrAppend(&html, "</div></div>");
  }
  absl::StrAppend(&html, "<p class=note>", Legend(view), "</p><div class=panels>");
  if (!view.residuals.empty()) absl::StrAppend(&html, ResidualPlot(view));
  if (!view.drift.empty() && view.figures.updates_applied > 0)
    absl::StrAppend(&html, DriftPlot(view));
  if (!view.latencies_s.empty()) absl::StrAppend(&html, LatencyPlot(view));
  return absl::StrCat(html, "</div>\n");
}

}  // namespace

std::string LiveMain(const LiveServer& server, const std::vector<Telemetry::View>& sessions,
                     Metrics& metrics) {
  std::vector<Telemetry::View> sorted = sessions;
  // Those in use keep their places while one looks at them.
  const auto place = [](const Telemetry::View& view) {
    const double idle_s = view.figures.idle_s < kInUse_s ? 0 : view.figures.idle_s;
    return std::pair<double, const std::string&>(idle_s, view.figures.id);
  };
  std::sort(sorted.begin(), sorted.end(),
            [&place](const auto& a, const auto& b) { return place(a) < place(b); });
  const auto open = std::count_if(sorted.begin(), sorted.end(),
                                  [](const auto& view) { return view.figures.open; });
  const auto predict = metrics.AddHistogram("robostress_predict_seconds", "", LatencyBounds());
  const auto answered = metrics.AddCounter("robostress_predictions_answered_total", "");
  const auto chunks = metrics.AddCounter("robostress_feedback_chunks_total", "");
  const auto applied = metrics.AddCounter("robostress_updates_total", "", {{"outcome", "applied"}});
  const bool any = answered->Value() > 0;
  std::string html =
      absl::StrCat("<main class=wrap><div class=tiles>", Tile(absl::StrCat(open), "open sessions"),
                   Tile(Latency(*predict, 0.5, any), "prediction, p50"),
                   Tile(Latency(*predict, 0.99, any), "prediction, p99"),
                   Tile(absl::StrFormat("%.0f", answered->Value()), "predictions"),
                   Tile(absl::StrFormat("%.0f", chunks->Value()), "executed chunks"),
                   Tile(absl::StrFormat("%.0f", applied->Value()), "updates applied"),
                   Tile(server.uptime, "since the start"), "</div>");
  if (server.draining)
    absl::StrAppend(&html,
                    "<div class=warn>Draining: new sessions and messages are refused.</div>");
  absl::StrAppend(&html, "<p class=note>", EscapeXml(server.policies),
                  server.durable ? ". Acknowledged feedback is on disk."
                                 : ". Sessions live in memory: they end with this server.",
                  "</p><h2>Sessions</h2>");
  if (sorted.empty()) return html + "<p class=note>None is open.</p></main>";
  absl::StrAppend(&html,
                  "<div class=scroll><table><tr><th>session<th>state, idle"
                  "<th>predictions<th>chunks<th>version<th>refused<th>duplicates<th>distance"
                  "<th>loss<th>p50 / p99 ms</tr>\n");
  for (const Telemetry::View& view : sorted) absl::StrAppend(&html, Row(view));
  absl::StrAppend(&html, "</table></div>\n");
  for (size_t i = 0; i < sorted.size() && i < kShownInFull; ++i)
    absl::StrAppend(&html, Session(sorted[i]));
  if (sorted.size() > kShownInFull) {
    absl::StrAppend(&html, "<p class=note>Plots and images are shown of the ", kShownInFull,
                    " sessions used last.</p>");
  }
  return absl::StrCat(html, "</main>");
}

std::string LivePage(const LiveServer& server, const std::vector<Telemetry::View>& sessions,
                     Metrics& metrics) {
  return absl::StrCat(
      PageHead("RoboStress policy server"),
      "<header><div class=wrap><h1>RoboStress policy server</h1><p>Who is served, how far each "
      "robot "
      "is from its commands, and what its adapter made of it.</p></div></header><nav><div "
      "class=wrap><a href=\"/metrics\">metrics</a><a href=\"/traces\">traces</a></div></nav>\n",
      LiveMain(server, sessions, metrics),
      "\n<footer class=wrap id=state>As of the request. Traces open in Perfetto.</footer>"
      "<script src=\"/live.js\"></script></body></html>\n");
}

std::string LiveScript() {
  return R"js('use strict';
async function refresh() {
  const state = document.getElementById('state');
  try {
    // Not relative to the page's own address, which may hold a password.
    const answer = await fetch(location.origin + '/main');
    if (!answer.ok) throw new Error('status ' + answer.status);
    const parsed = new DOMParser().parseFromString(await answer.text(), 'text/html');
    document.querySelector('main').replaceWith(parsed.querySelector('main'));
    state.textContent = 'As of ' + new Date().toLocaleTimeString() + '. Traces open in Perfetto.';
  } catch (error) {
    state.textContent = 'The server does not answer (' + error.message + '); what is shown is old.';
  }
  setTimeout(refresh, 1000);
}
setTimeout(refresh, 1000);
)js";
}

}  // namespace robostress
