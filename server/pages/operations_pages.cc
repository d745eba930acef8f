#include "server/pages/operations_pages.h"

#include <map>
#include <string>

#include "absl/strings/numbers.h"
#include "absl/strings/str_split.h"
#include "common/image.h"
#include "server/operations/access_table.h"

namespace robostress {
namespace {

constexpr char kHtml[] = "text/html; charset=utf-8";

// Key and value pairs of a query; %XX and '+' are undone.
std::map<std::string, std::string> ParseQuery(const std::string& query) {
  const auto hex = [](char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    return -1;
  };
  const auto plain = [&hex](const std::string& text) {
    std::string out;
    for (size_t i = 0; i < text.size(); ++i) {
      const bool coded =
          text[i] == '%' && i + 2 < text.size() && hex(text[i + 1]) >= 0 && hex(text[i + 2]) >= 0;
      if (coded) {
        out += static_cast<char>(16 * hex(text[i + 1]) + hex(text[i + 2]));
        i += 2;
      } else {
        out += text[i] == '+' ? ' ' : text[i];
      }
    }
    return out;
  };
  std::map<std::string, std::string> pairs;
  const std::vector<std::string> parts = absl::StrSplit(query, '&');
  for (const std::string& part : parts) {
    const size_t equals = part.find('=');
    if (equals != std::string::npos)
      pairs[plain(part.substr(0, equals))] = plain(part.substr(equals + 1));
  }
  return pairs;
}

WebReply ImagePage(const WebRequest& request, const Telemetry& telemetry) {
  const std::map<std::string, std::string> query = ParseQuery(request.query);
  const auto session = query.find("session"), camera = query.find("camera");
  const std::shared_ptr<const Image> image =
      session == query.end() || camera == query.end()
          ? nullptr
          : telemetry.LastImage(session->second, camera->second);
  if (image == nullptr)
    return ErrorReply(absl::NotFoundError("no image: /image?session=ID&camera=NAME of one shown"));
  absl::StatusOr<std::string> png = EncodePng(*image);
  if (!png.ok()) return ErrorReply(png.status());
  return {200, "image/png", *std::move(png)};
}

}  // namespace

WebReply HealthPage(const WebRequest& request, const std::function<bool()>& ready) {
  if (request.path == "/healthz") return {200, "text/plain; charset=utf-8", "OK\n"};
  if (request.path != "/readyz")
    return ErrorReply(absl::NotFoundError("no such page; there are /healthz and /readyz"));
  if (ready()) return {200, "text/plain; charset=utf-8", "ready\n"};
  return ErrorReply(absl::UnavailableError("warming up or draining"));
}

WebReply OperationsPage(const WebRequest& request, const OperationsSources& sources) {
  const std::string& path = request.path;
  const absl::StatusOr<Caller> caller =
      Allow(*sources.tokens->Get(), request.authorization, AccessRule::Wire::kHttp, path);
  if (absl::IsNotFound(caller.status())) {
    const absl::Status admin = sources.tokens->Get()->Check(request.authorization, Scope::kAdmin);
    if (!admin.ok()) return ErrorReply(admin);
    return ErrorReply(
        absl::NotFoundError("no such page; there are /, /metrics, /traces, /healthz and /readyz"));
  }
  if (!caller.ok()) return ErrorReply(caller.status());
  if (path == "/healthz" || path == "/readyz") return HealthPage(request, sources.ready);
  if (path == "/live.js") return {200, "text/javascript; charset=utf-8", LiveScript()};
  if (path == "/image") return ImagePage(request, *sources.telemetry);
  if (path == "/traces") return {200, "application/json", sources.traces->Json()};
  sources.telemetry->Refresh(sources.figures());
  if (path == "/metrics")
    return {200, "text/plain; version=0.0.4; charset=utf-8", sources.metrics->Text()};
  const auto views = sources.telemetry->Views();
  return {200, kHtml,
          path == "/" ? LivePage(sources.server(), views, *sources.metrics)
                      : LiveMain(sources.server(), views, *sources.metrics)};
}

}  // namespace robostress
