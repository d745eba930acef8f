#include "eval/launch/server_process.h"

#include <poll.h>
#include <stdlib.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "eval/plan/build_info.h"
#include "eval/plan/plan.h"
#include "eval/store/processor_kind.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using SteadyClock = std::chrono::steady_clock;

// "4242" or "127.0.0.1:4242" in a port file.
absl::StatusOr<int> PortIn(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  const std::string place(absl::StripAsciiWhitespace(text));
  int port = 0;
  if (!absl::SimpleAtoi(place.substr(place.rfind(':') + 1), &port) || port < 1 || port > 65535)
    return absl::DataLossError(absl::StrCat(file, " holds '", place, "', which is no port"));
  return port;
}

}  // namespace

void ChooseOpenMpBlas() {
  if (access(absl::StrCat(kOpenMpBlasDir, "/libblas.so.3").c_str(), R_OK) != 0) return;
  const char* current = std::getenv("LD_LIBRARY_PATH");
  if (current != nullptr && absl::StrContains(current, kOpenMpBlasDir)) return;
  const std::string path = current == nullptr || *current == '\0'
                               ? std::string(kOpenMpBlasDir)
                               : absl::StrCat(kOpenMpBlasDir, ":", current);
  setenv("LD_LIBRARY_PATH", path.c_str(), 1);
}

const std::map<std::string, std::string>& ChildEnvironment() {
  static const auto& environment =
      *new std::map<std::string, std::string>{{"OMP_NUM_THREADS", "1"},
                                              {"OPENBLAS_NUM_THREADS", "1"},
                                              {"MKL_NUM_THREADS", "1"},
                                              {"LP_NUM_THREADS", "0"}};
  return environment;
}

absl::StatusOr<ServerProcess> StartServer(const ServerStart& start, SignalGuard& signals) {
  RS_ASSIGN_OR_RETURN(const std::string program, FindProgram("serve"));
  const std::string log = absl::StrCat(start.log_folder, "/server-", start.label, ".log");
  const std::string port_file = absl::StrCat(start.log_folder, "/server-", start.label, ".port");
  std::error_code ignored;
  fs::remove(port_file, ignored);
  RS_ASSIGN_OR_RETURN(
      ChildProcess process,
      ChildProcess::Start({program, "--policy", start.policy, "--listen", start.listen,
                           "--port-file", port_file, "--threads", absl::StrCat(start.threads),
                           // It serves this run alone, whose methods may cost what they cost.
                           "--max-rank", "256", "--max-update-batch", "4096",
                           "--min-update-interval", "1", "--max-buffer-chunks", "4096"},
                          ChildEnvironment(), log));
  const auto deadline = SteadyClock::now() + std::chrono::seconds(start.timeout_s);
  while (!fs::exists(port_file)) {
    pollfd items[] = {{process.exit_fd(), POLLIN, 0}, {signals.fd(), POLLIN, 0}};
    poll(items, 2, 50);
    if (items[1].revents != 0)
      return absl::CancelledError("interrupted while the policy server started");
    if (const std::optional<ExitState> exit = process.Poll()) {
      return absl::UnavailableError(absl::StrCat("the server of policy ", PolicyLabel(start.policy),
                                                 " ended at its start (", exit->text, "). Its log ",
                                                 log, " ends:\n", LastLines(log, 15)));
    }
    if (SteadyClock::now() > deadline) {
      return absl::UnavailableError(absl::StrCat("the server of policy ", PolicyLabel(start.policy),
                                                 " did not open a port within ", start.timeout_s,
                                                 " s; see ", log));
    }
  }
  RS_ASSIGN_OR_RETURN(const int port, PortIn(port_file));
  return ServerProcess{std::move(process), port, log};
}

absl::Status LocalServers::Start(const ServerStart& start, SignalGuard& signals) {
  RS_ASSIGN_OR_RETURN(ServerProcess server, StartServer(start, signals));
  servers_.emplace(start.policy, std::move(server));
  return absl::OkStatus();
}

void LocalServers::Stop() {
  for (auto& [policy, server] : servers_) server.process.Terminate(5000);
}

absl::StatusOr<ServerPlace> LocalServers::Find(const std::string& policy) {
  if (!elsewhere_.empty()) return elsewhere_.Next();
  return ServerPlace{absl::StrCat("127.0.0.1:", servers_.at(policy).port), ThisProcessor().Text()};
}

absl::Status LocalServers::Check() {
  for (auto& [policy, server] : servers_) {
    if (const std::optional<ExitState> exit = server.process.Poll()) {
      return absl::UnavailableError(absl::StrCat(
          "the server of policy ", PolicyLabel(policy), " ended (", exit->text,
          ") while units needed it. Its log ", server.log, " ends:\n", LastLines(server.log, 15)));
    }
  }
  return absl::OkStatus();
}

std::vector<int> LocalServers::wake_fds() const {
  std::vector<int> fds;
  for (const auto& [policy, server] : servers_) fds.push_back(server.process.exit_fd());
  return fds;
}

}  // namespace robostress
