#include "server/operations/access_table.h"

#include <string>

#include "absl/strings/str_cat.h"
#include "common/status_macros.h"

namespace robostress {
namespace {

constexpr uint8_t kPredict = static_cast<uint8_t>(Scope::kPredict);
constexpr uint8_t kFeedback = static_cast<uint8_t>(Scope::kFeedback);
constexpr uint8_t kAdmin = static_cast<uint8_t>(Scope::kAdmin);
constexpr uint8_t kMetrics = static_cast<uint8_t>(Scope::kMetrics);
using Wire = AccessRule::Wire;

constexpr AccessRule kTable[] = {
    {Wire::kPolicy, "GetServerInfo", kPredict, false},
    {Wire::kPolicy, "OpenSession", kPredict, false},
    {Wire::kPolicy, "ResumeSession", kPredict, true},
    {Wire::kPolicy, "CloseSession", kPredict, true},
    {Wire::kPolicy, "StartEpisode", kPredict, true},
    {Wire::kPolicy, "Predict", kPredict, true},
    {Wire::kPolicy, "Feedback", kFeedback, true},
    {Wire::kPolicy, "GetStats", kPredict, true},
    {Wire::kPolicy, "ExportAdapter", kFeedback, true},
    {Wire::kPolicy, "ImportAdapter", kFeedback, true},
    {Wire::kPolicy, "RollbackAdapter", kFeedback, true},

    {Wire::kAdmin, "ListSessions", kAdmin, false},
    {Wire::kAdmin, "ListVersions", kAdmin, false},
    {Wire::kAdmin, "PinVersion", kAdmin, false},
    {Wire::kAdmin, "ExportVersion", kAdmin, false},
    {Wire::kAdmin, "RollbackSession", kAdmin, false},
    {Wire::kAdmin, "EndSession", kAdmin, false},
    {Wire::kAdmin, "Drain", kAdmin, false},

    {Wire::kHttp, "/healthz", 0, false},
    {Wire::kHttp, "/readyz", 0, false},
    {Wire::kHttp, "/metrics", kMetrics | kAdmin, false},
    {Wire::kHttp, "/", kAdmin, false},
    {Wire::kHttp, "/main", kAdmin, false},
    {Wire::kHttp, "/live.js", kAdmin, false},
    {Wire::kHttp, "/image", kAdmin, false},
    {Wire::kHttp, "/traces", kAdmin, false},

    {Wire::kWebSocket, "upgrade", kPredict, false},
    {Wire::kWebSocket, "resume", kPredict, true},
    {Wire::kWebSocket, "observation", kPredict, true},
    {Wire::kWebSocket, "executed", kFeedback, true},
};

std::string NamesOf(uint8_t scopes) {
  std::string names;
  for (const Scope scope : kScopes) {
    if ((scopes & static_cast<uint8_t>(scope)) == 0) continue;
    absl::StrAppend(&names, names.empty() ? "'" : " or '", ScopeName(scope), "'");
  }
  return names;
}

absl::StatusOr<const AccessRule*> RuleOf(Wire wire, std::string_view what) {
  if (const AccessRule* rule = FindRule(wire, what)) return rule;
  return absl::NotFoundError(
      absl::StrCat("there is no ", std::string(what.substr(0, 64)), " here"));
}

}  // namespace

absl::Span<const AccessRule> AccessTable() { return kTable; }

const AccessRule* FindRule(Wire wire, std::string_view what) {
  for (const AccessRule& rule : kTable)
    if (rule.wire == wire && rule.what == what) return &rule;
  return nullptr;
}

absl::Status Allow(const Caller& caller, Wire wire, std::string_view what) {
  RS_ASSIGN_OR_RETURN(const AccessRule* rule, RuleOf(wire, what));
  if (rule->scopes == 0 || (caller.scopes & rule->scopes) != 0) return absl::OkStatus();
  return absl::PermissionDeniedError(
      absl::StrCat("the token of '", caller.name, "' has no scope ", NamesOf(rule->scopes)));
}

absl::StatusOr<Caller> Allow(const AccessTokens& tokens, std::string_view authorization, Wire wire,
                             std::string_view what) {
  RS_ASSIGN_OR_RETURN(const AccessRule* rule, RuleOf(wire, what));
  if (rule->scopes == 0) {
    Caller nobody;
    nobody.name = "nobody";
    return nobody;
  }
  RS_ASSIGN_OR_RETURN(Caller caller, tokens.Authenticate(authorization));
  RS_RETURN_IF_ERROR(Allow(caller, wire, what));
  return caller;
}

}  // namespace robostress
