#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "eval/launch/server_source.h"
#include "eval/launch/servers_elsewhere.h"
#include "eval/launch/signal_guard.h"
#include "eval/launch/submission.h"

namespace robostress {

// Says where a server job answers, for the worker tasks of its submission.
absl::Status PublishServer(const Submission& submission, const std::string& policy, int index,
                           const ServerPlace& place);

// The servers that a submission's server jobs have published. A file may be older than its server's
// death, so a place counts only when something accepts a connection there.
class PublishedServers : public ServerSource {
 public:
  // `preferred` spreads tasks over servers; Find waits for up to `patience_s`.
  PublishedServers(const Submission& submission, int preferred, double patience_s,
                   SignalGuard& signals)
      : submission_(submission),
        elsewhere_(submission.elsewhere(), static_cast<size_t>(preferred)),
        preferred_(preferred),
        patience_s_(patience_s),
        signals_(signals) {}

  absl::StatusOr<ServerPlace> Find(const std::string& policy) override;
  absl::Status Check() override { return absl::OkStatus(); }
  bool Lost(const std::string& policy, const ServerPlace& place) override;
  std::vector<int> wake_fds() const override { return {}; }

 private:
  const Submission& submission_;
  ServersElsewhere elsewhere_;
  const int preferred_;
  const double patience_s_;
  SignalGuard& signals_;
};

}  // namespace robostress
