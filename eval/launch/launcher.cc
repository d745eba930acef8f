#include "eval/launch/launcher.h"

#include <set>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/status_macros.h"
#include "eval/launch/cluster_launchers.h"
#include "eval/launch/policy_urls.h"
#include "eval/launch/server_process.h"

namespace robostress {

std::vector<std::string> LauncherNames() {
  std::vector<std::string> names = {"local"};
  for (const ClusterLauncher& cluster : ClusterLaunchers()) names.emplace_back(cluster.name);
  return names;
}

absl::StatusOr<std::unique_ptr<Launcher>> MakeLauncher(const std::string& name) {
  if (name == "local") return std::make_unique<LocalLauncher>();
  for (const ClusterLauncher& cluster : ClusterLaunchers()) {
    if (name == cluster.name) return cluster.make();
  }
  return absl::InvalidArgumentError(absl::StrCat("unknown launcher '", name,
                                                 "'; known: ", absl::StrJoin(LauncherNames(), ", "),
                                                 LaunchersLeftOut()));
}

std::vector<std::string> LaunchOptions::Elsewhere() const {
  if (!policy_urls.empty() || server.empty()) return policy_urls;
  return {server};
}

absl::StatusOr<LaunchResult> LocalLauncher::Launch(const LaunchRequest& request) {
  const LaunchOptions& options = request.options;
  RS_RETURN_IF_ERROR(DialPolicyUrls(options.policy_urls, request.grid));
  const std::vector<std::string> elsewhere = options.Elsewhere();
  LocalServers servers(elsewhere);
  std::set<std::string> policies;
  for (const WorkItem& item : request.items) {
    if (!RunsInWorker(item.unit->config.policy)) policies.insert(item.unit->config.policy);
  }
  if (!elsewhere.empty()) policies.clear();
  for (const std::string& policy : policies) {
    ServerStart start;
    start.policy = policy;
    start.label = PolicyLabel(policy);
    start.log_folder = request.run.path() + "/logs";
    start.threads = options.workers;
    start.timeout_s = options.server_start_timeout_s;
    RS_RETURN_IF_ERROR(servers.Start(start, request.signals));
  }
  const PoolOptions pool_options = {options.workers, options.measure_lag, options.record_joints,
                                    options.record_views};
  LaunchResult result;
  WorkerPool pool(request.run, pool_options, servers, request.signals, request.progress);
  const absl::Status status = pool.Run(request.items, result.outcome);
  servers.Stop();
  RS_RETURN_IF_ERROR(status);
  return result;
}

}  // namespace robostress
