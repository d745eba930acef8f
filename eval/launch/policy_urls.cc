#include "eval/launch/policy_urls.h"

#include <memory>

#include "absl/strings/str_cat.h"
#include "common/client_secrets.h"
#include "common/status_macros.h"
#include "common/wire/remote_policy.h"
#include "spdlog/spdlog.h"

namespace robostress {

absl::Status DialPolicyUrls(const std::vector<std::string>& urls, const SweepGrid& grid) {
  if (urls.empty()) return absl::OkStatus();
  SessionSetting setting;
  setting.policy = grid.policies.front();
  setting.suite = grid.suites.front();
  RemotePolicyConnection connection;
  RS_ASSIGN_OR_RETURN(connection.wire.socket.secrets, ClientSecretsFromEnvironment());
  std::string model, there;  // of the first that greets, and its address
  std::vector<absl::Status> absent;
  for (const std::string& url : urls) {
    const auto policy = RemotePolicy::Connect(url, grid.remote, setting, "policy", connection);
    const absl::Status dialled = absl::Status(
        policy.status().code(), absl::StrCat("--policy-url: ", policy.status().message()));
    if (!policy.ok()) {
      if (!absl::IsUnavailable(dialled) && !absl::IsDeadlineExceeded(dialled)) return dialled;
      absent.push_back(dialled);
      continue;
    }
    const std::string said = (*policy)->spec().model_hash;
    if (there.empty()) {
      model = said;
      there = (*policy)->address();
    } else if (said != model) {
      spdlog::warn("{} and {} do not say the same of the model that they serve; is it one?", there,
                   (*policy)->address());
    }
  }
  if (there.empty()) return absent.front();
  for (const absl::Status& one : absent)
    spdlog::warn("{}; units go to the other servers meanwhile", std::string(one.message()));
  return absl::OkStatus();
}

}  // namespace robostress
