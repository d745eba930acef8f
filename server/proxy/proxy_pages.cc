#include "server/proxy/proxy_pages.h"

#include <algorithm>
#include <utility>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/html_page.h"
#include "common/svg_elements.h"
#include "common/svg_plot.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

constexpr int kWidth = 420;  // of a plot, two beside each other
constexpr const char* kLineColours[] = {"#0072b2", "#e69f00", "#009e73", "#d55e00",
                                        "#cc79a7", "#56b4e9", "#8a8a8a"};

std::string Figure(const std::string& value, const std::string& label) {
  return absl::StrCat("<div class=tile><b>", EscapeXml(value), "</b><span>", EscapeXml(label),
                      "</span></div>");
}

std::string ColourOf(size_t line) { return kLineColours[line % std::size(kLineColours)]; }

std::string Curves(const std::string& title, const std::vector<Eigen::VectorXd>& values,
                   const std::vector<std::string>& axes) {
  std::vector<LineSeries> lines(axes.size());
  for (size_t j = 0; j < axes.size(); ++j) {
    lines[j].name = axes[j];
    lines[j].color = ColourOf(j);
    for (size_t i = 0; i < values.size(); ++i) {
      lines[j].x.push_back(static_cast<double>(i));
      lines[j].y.push_back(values[i][static_cast<Eigen::Index>(j)]);
    }
  }
  LinePlotOptions options;
  options.title = title;
  options.x_label = absl::StrCat("the last ", values.size(), " answers");
  options.width = kWidth;
  options.dots = values.size() < 2;
  return LinePlot(lines, options);
}

std::string Legend(const std::vector<std::string>& axes) {
  std::string html = "<p class=note>";
  for (size_t j = 0; j < axes.size(); ++j)
    absl::StrAppend(&html, "<span style=\"color:", ColourOf(j), "\">&#9632;</span> ",
                    EscapeXml(axes[j]), " &nbsp;");
  return html + "</p>";
}

uint64_t Sum(const std::vector<ProxyClientView>& views, AnswerOutcome outcome) {
  uint64_t sum = 0;
  for (const ProxyClientView& view : views) sum += view.outcomes[static_cast<size_t>(outcome)];
  return sum;
}

std::string ClientRow(const ProxyClientView& view) {
  const auto of = [&view](AnswerOutcome outcome) {
    return view.outcomes[static_cast<size_t>(outcome)];
  };
  return absl::StrCat("<tr><td>", EscapeXml(view.peer), "</td><td>", view.open ? "open" : "gone",
                      absl::StrFormat(", %.0f s", view.idle_s), "</td><td>",
                      of(AnswerOutcome::kCorrected), "</td><td>", of(AnswerOutcome::kZero),
                      "</td><td>", of(AnswerOutcome::kShadow), "</td><td>", of(AnswerOutcome::kOff),
                      "</td><td>", of(AnswerOutcome::kDoubt),
                      "</td><td style=\"white-space:normal\">",
                      EscapeXml(view.last_doubt.substr(0, 200)), "</td></tr>\n");
}

std::string Held(const Histogram& held, double quantile) {
  return absl::StrFormat("%.3g ms", 1e3 * QuantileOf(held, quantile));
}

std::string MainPage(const ProxySources& sources) {
  const ProxyBoard& board = *sources.board;
  const std::vector<ProxyClientView> views = board.Views();
  const RelayFigures relay = sources.relay->figures();
  std::string head = PageHead("RoboStress proxy");
  // It needs no script.
  const size_t end = head.find("</head>");
  if (end != std::string::npos) head.insert(end, "<meta http-equiv=refresh content=2>");
  std::string html = absl::StrCat(
      head, "<header><div class=wrap><h1>RoboStress proxy</h1><p>", EscapeXml(board.profile().name),
      " before ", EscapeXml(sources.upstream), ", method ", EscapeXml(board.method().method),
      "</p></div></header><main class=wrap><div class=tiles>",
      Figure(ProxyModeName(board.mode()), "mode"),
      Figure(relay.upstream_there ? "there" : "gone", "policy server"),
      Figure(absl::StrCat(relay.clients), "clients"),
      Figure(absl::StrCat(Sum(views, AnswerOutcome::kCorrected)), "answers corrected"),
      Figure(absl::StrCat(Sum(views, AnswerOutcome::kDoubt)), "left alone in doubt"),
      Figure(Held(board.held(), 0.5), "held, p50"), Figure(Held(board.held(), 0.99), "held, p99"),
      "</div>");
  if (const std::string failure = board.record_failure(); !failure.empty())
    absl::StrAppend(&html, "<p class=note>The record ended: ", EscapeXml(failure), "</p>");
  absl::StrAppend(&html, "<h2>Clients</h2>");
  if (views.empty()) return html + "<p class=note>None came yet.</p></main></body></html>\n";
  absl::StrAppend(&html,
                  "<div class=scroll><table><tr><th>client<th>state, idle<th>corrected"
                  "<th>nothing to correct<th>shadow<th>off<th>doubt<th>last doubt</tr>\n");
  for (const ProxyClientView& view : views) absl::StrAppend(&html, ClientRow(view));
  absl::StrAppend(&html, "</table></div>\n");
  const std::vector<std::string> axes = board.profile().axes();
  absl::StrAppend(&html, Legend(axes));
  for (const ProxyClientView& view : views) {
    if (view.residuals.empty() && view.corrections.empty()) continue;
    absl::StrAppend(&html, "<h3>", EscapeXml(view.peer), "</h3><div class=panels>");
    if (!view.residuals.empty())
      absl::StrAppend(&html, Curves("residual [action units]", view.residuals, axes));
    if (!view.corrections.empty())
      absl::StrAppend(&html, Curves("correction [action units]", view.corrections, axes));
    absl::StrAppend(&html, "</div>\n");
  }
  return html + "</main></body></html>\n";
}

// The switch, as one program uses it.
class SwitchConversation : public WebConversation {
 public:
  explicit SwitchConversation(const ProxySources& sources) : sources_(sources) {}
  std::string Greeting() override { return ProxyStateJson(sources_); }
  uint64_t LargestMessage() const override { return 64; }
  absl::StatusOr<std::string> Answer(std::string_view message) override {
    if (message == "on" || message == "off") {
      sources_.board->Switch(message == "on");
    } else if (message != "state") {
      return absl::InvalidArgumentError("say on, off or state");
    }
    return ProxyStateJson(sources_);
  }

 private:
  const ProxySources sources_;
};

}  // namespace

std::string ProxyStateJson(const ProxySources& sources) {
  const std::vector<ProxyClientView> views = sources.board->Views();
  const RelayFigures relay = sources.relay->figures();
  nlohmann::ordered_json state = {{"mode", ProxyModeName(sources.board->mode())},
                                  {"robot", sources.board->profile().name},
                                  {"method", sources.board->method().method},
                                  {"upstream", sources.upstream},
                                  {"upstream_there", relay.upstream_there},
                                  {"clients", relay.clients},
                                  {"accepted", relay.accepted},
                                  {"refused", relay.refused},
                                  {"upstream_lost", relay.upstream_lost}};
  for (size_t i = 0; i < kAnswerOutcomes; ++i) {
    const auto outcome = static_cast<AnswerOutcome>(i);
    state["answers"][AnswerOutcomeName(outcome)] = Sum(views, outcome);
  }
  for (size_t i = 0; i < kDoubts; ++i) {
    uint64_t sum = 0;
    for (const ProxyClientView& view : views) sum += view.doubts[i];
    if (sum > 0) state["doubts"][DoubtName(static_cast<Doubt>(i))] = sum;
  }
  state["held_ms"] = {{"p50", 1e3 * QuantileOf(sources.board->held(), 0.5)},
                      {"p99", 1e3 * QuantileOf(sources.board->held(), 0.99)}};
  if (const std::string failure = sources.board->record_failure(); !failure.empty())
    state["record_failure"] = failure;
  return state.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

WebReply ProxyPage(const WebRequest& request, const ProxySources& sources) {
  if (request.path == "/healthz") return {200, "text/plain; charset=utf-8", "OK\n"};
  if (request.path == "/readyz") {
    if (sources.relay->figures().upstream_there)
      return {200, "text/plain; charset=utf-8", "ready\n"};
    return ErrorReply(absl::UnavailableError("the policy server is not there"));
  }
  if (request.path == "/metrics")
    return {200, "text/plain; version=0.0.4; charset=utf-8", sources.metrics->Text()};
  if (request.path == "/state") return {200, "application/json", ProxyStateJson(sources) + "\n"};
  if (request.path == "/") return {200, "text/html; charset=utf-8", MainPage(sources)};
  return ErrorReply(
      absl::NotFoundError("no such page; there are /, /state, /metrics, /healthz and /readyz"));
}

absl::StatusOr<std::unique_ptr<WebConversation>> OpenProxySwitch(const WebRequest& request,
                                                                 const ProxySources& sources) {
  if (request.path != "/switch") return absl::NotFoundError("the switch is at /switch");
  if (!absl::StartsWith(request.peer, "127.") && !absl::StartsWith(request.peer, "::1"))
    return absl::PermissionDeniedError("the switch is for programs on the proxy's own machine");
  return std::make_unique<SwitchConversation>(sources);
}

}  // namespace robostress
