#include "eval/launch/policy_urls.h"

#include "absl/strings/str_cat.h"
#include "common/client_secrets.h"
#include "common/status_macros.h"
#include "common/wire/remote_policy.h"

namespace robostress {

absl::Status DialPolicyUrls(const std::vector<std::string>& urls, const SweepGrid& grid) {
  if (urls.empty()) return absl::OkStatus();
  SessionSetting setting;
  setting.policy = grid.policies.front();
  setting.suite = grid.suites.front();
  RemotePolicyConnection connection;
  RS_ASSIGN_OR_RETURN(connection.wire.socket.secrets, ClientSecretsFromEnvironment());
  absl::Status first;
  for (const std::string& url : urls) {
    const absl::Status dialled =
        RemotePolicy::Connect(url, grid.remote, setting, "policy", connection).status();
    if (dialled.ok()) return dialled;
    if (first.ok()) first = dialled;
  }
  return absl::Status(first.code(), absl::StrCat("--policy-url: ", first.message()));
}

}  // namespace robostress
