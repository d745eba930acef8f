#pragma once

#include <map>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/child_process.h"
#include "eval/launch/server_source.h"
#include "eval/launch/servers_elsewhere.h"
#include "eval/launch/signal_guard.h"

namespace robostress {

// Prepends the OpenMP build of OpenBLAS to LD_LIBRARY_PATH of this process's children, where it is
// installed: the pthread build, Debian's default alternative, ignores the thread counts that
// LibTorch sets.
void ChooseOpenMpBlas();

// One thread per process: a grid's parallelism is its processes, and results must not depend on
// thread counts.
const std::map<std::string, std::string>& ChildEnvironment();

struct ServerStart {
  std::string policy;
  std::string label;  // names the files below
  std::string log_folder;
  std::string listen = "127.0.0.1:0";
  int threads = 1;
  int timeout_s = 180;
};

// A policy server that this process started.
struct ServerProcess {
  ChildProcess process;
  int port = 0;
  std::string log;
};

// Starts `robostress serve` and waits until it answers. Unavailable, with the end of its log, when
// it ends before or takes longer than the timeout; Cancelled when a signal comes.
absl::StatusOr<ServerProcess> StartServer(const ServerStart& start, SignalGuard& signals);

// The servers of a sweep on this machine, one per policy; or addresses of servers that run already,
// which are given in turn.
class LocalServers : public ServerSource {
 public:
  explicit LocalServers(std::vector<std::string> elsewhere) : elsewhere_(std::move(elsewhere)) {}
  absl::Status Start(const ServerStart& start, SignalGuard& signals);
  void Stop();  // SIGTERM, then SIGKILL

  absl::StatusOr<ServerPlace> Find(const std::string& policy) override;
  absl::Status Check() override;
  // Of its own servers Check says it.
  bool Lost(const std::string&, const ServerPlace& place) override {
    return elsewhere_.Lost(place);
  }
  std::vector<int> wake_fds() const override;

 private:
  ServersElsewhere elsewhere_;
  std::map<std::string, ServerProcess> servers_;
};

}  // namespace robostress
