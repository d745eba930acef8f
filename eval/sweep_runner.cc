#include "eval/sweep_runner.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <string.h>
#include <sys/file.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <chrono>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <map>
#include <set>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/atomic_file.h"
#include "common/config.h"
#include "common/joint_errors/scenario_file.h"
#include "common/program_folder.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "eval/process.h"
#include "eval/progress.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using Seconds = std::chrono::duration<double>;
using SteadyClock = std::chrono::steady_clock;

// One thread per process: the sweep's parallelism is its processes, and results must not depend on
// thread counts.
const std::map<std::string, std::string>& ChildEnvironment() {
  static const auto& environment =
      *new std::map<std::string, std::string>{{"OMP_NUM_THREADS", "1"},
                                              {"OPENBLAS_NUM_THREADS", "1"},
                                              {"MKL_NUM_THREADS", "1"},
                                              {"LP_NUM_THREADS", "0"}};
  return environment;
}

// An owned file descriptor.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (fd_ >= 0) close(fd_);
  }
  int get() const { return fd_; }

 private:
  int fd_;
};

// Turns SIGINT and SIGTERM into a readable descriptor for as long as it lives.
class SignalGuard {
 public:
  SignalGuard() : fd_(Block(previous_)) {}
  ~SignalGuard() { sigprocmask(SIG_SETMASK, &previous_, nullptr); }
  int fd() const { return fd_.get(); }

 private:
  static int Block(sigset_t& previous) {
    sigset_t set;
    sigemptyset(&set);
    sigaddset(&set, SIGINT);
    sigaddset(&set, SIGTERM);
    sigprocmask(SIG_BLOCK, &set, &previous);
    return signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
  }
  sigset_t previous_;
  Descriptor fd_;
};

std::string UtcNow() {
  const std::time_t now = std::time(nullptr);
  char text[32];
  std::tm parts;
  std::strftime(text, sizeof(text), "%Y-%m-%dT%H:%M:%SZ", gmtime_r(&now, &parts));
  return text;
}

// Expected cost in control steps, for the order of dispatch only.
double ExpectedCost(const PlannedUnit& unit) {
  const SuiteInfo* suite = FindSuite(unit.config.suite);
  const double horizon = suite == nullptr ? 300 : suite->horizon;
  return unit.EpisodeCount() * horizon * (unit.config.scenario == "clean" ? 0.5 : 1) *
         (unit.config.method.adapt ? 1.5 : 1);
}

class Sweep {
 public:
  Sweep(const std::vector<PlannedUnit>& units, const LaunchOptions& options)
      : units_(units), options_(options), dir_(options.run_dir) {}

  absl::StatusOr<SweepOutcome> Run(const SweepGrid& grid);

 private:
  struct Running {
    const PlannedUnit* unit;
    ChildProcess process;
  };
  struct Server {
    ChildProcess process;
    std::string address;
    std::string log;
  };

  std::string UnitDir(const PlannedUnit& unit) const {
    return absl::StrCat(dir_, "/units/", unit.id);
  }
  std::string UnitLog(const PlannedUnit& unit) const {
    return absl::StrCat(dir_, "/logs/", unit.id, ".log");
  }
  bool Done(const PlannedUnit& unit) const { return fs::exists(UnitDir(unit) + "/DONE"); }

  absl::Status Prepare(const SweepGrid& grid);
  absl::Status WritePlan(const PlannedUnit& unit);
  absl::Status KeepScenario(const std::string& scenario) const;
  absl::Status StartServers(const std::vector<const PlannedUnit*>& pending);
  absl::Status StartServer(const std::string& policy);
  absl::StatusOr<ChildProcess> StartWorker(const PlannedUnit& unit);
  absl::Status RunPending(std::vector<const PlannedUnit*> pending);
  // Waits for an event; false when the sweep was interrupted.
  bool WaitForEvent(int timeout_ms);
  void Collect(Progress& progress);
  absl::Status CheckServers();

  const std::vector<PlannedUnit>& units_;
  const LaunchOptions& options_;
  const std::string dir_;
  SignalGuard signals_;
  std::map<std::string, Server> servers_;
  std::vector<Running> running_;
  SweepOutcome outcome_;
};

absl::Status Sweep::WritePlan(const PlannedUnit& unit) {
  const std::string file = absl::StrCat(dir_, "/plan/", unit.id, ".yaml");
  const std::string text = DumpConfig(unit.config);
  if (fs::exists(file)) {
    RS_ASSIGN_OR_RETURN(const std::string present, ReadFile(file));
    if (present == text) return absl::OkStatus();
    // Until a worker has written something there is nothing to protect.
    if (fs::exists(UnitDir(unit))) {
      return absl::FailedPreconditionError(absl::StrCat(
          file,
          " plans this unit with another configuration, and it has been started: results of "
          "different configurations "
          "cannot share a run directory. Choose another --out, or repeat the options of ",
          dir_, "/sweep.yaml"));
    }
  }
  return WriteFileAtomically(file, text);
}

// A scenario file may change; results of two versions of it cannot share a run directory.
absl::Status Sweep::KeepScenario(const std::string& scenario) const {
  if (!IsScenarioFile(scenario)) return absl::OkStatus();
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(scenario));
  RS_RETURN_IF_ERROR(MakeDirectories(dir_ + "/scenarios"));
  const std::string kept = absl::StrCat(dir_, "/scenarios/", ScenarioLabel(scenario), ".yaml");
  if (fs::exists(kept)) {
    RS_ASSIGN_OR_RETURN(const std::string present, ReadFile(kept));
    if (present == text) return absl::OkStatus();
    return absl::FailedPreconditionError(
        absl::StrCat(scenario, " has changed since this run began, which kept it as ", kept,
                     "; choose another --out, or restore the file"));
  }
  return WriteFileAtomically(kept, text);
}

absl::Status Sweep::Prepare(const SweepGrid& grid) {
  for (const char* folder : {"", "/plan", "/units", "/logs"})
    RS_RETURN_IF_ERROR(MakeDirectories(dir_ + folder));
  for (const PlannedUnit& unit : units_) RS_RETURN_IF_ERROR(WritePlan(unit));
  for (const std::string& scenario : grid.scenarios) RS_RETURN_IF_ERROR(KeepScenario(scenario));
  return WriteFileAtomically(dir_ + "/sweep.yaml", DumpConfig(grid));
}

absl::Status Sweep::StartServer(const std::string& policy) {
  RS_ASSIGN_OR_RETURN(const std::string program, FindProgram("serve"));
  const std::string label = PolicyLabel(policy);
  const std::string log = absl::StrCat(dir_, "/logs/server-", label, ".log");
  const std::string port_file = absl::StrCat(dir_, "/logs/server-", label, ".port");
  std::error_code ignored;
  fs::remove(port_file, ignored);
  RS_ASSIGN_OR_RETURN(
      ChildProcess process,
      ChildProcess::Start({program, "--policy", policy, "--listen", "127.0.0.1:0", "--port-file",
                           port_file, "--threads", absl::StrCat(options_.workers)},
                          ChildEnvironment(), log));
  const auto deadline = SteadyClock::now() + std::chrono::seconds(options_.server_start_timeout_s);
  while (!fs::exists(port_file)) {
    pollfd items[] = {{process.exit_fd(), POLLIN, 0}, {signals_.fd(), POLLIN, 0}};
    poll(items, 2, 50);
    if (items[1].revents != 0)
      return absl::CancelledError("interrupted while the policy server started");
    if (const std::optional<ExitState> exit = process.Poll()) {
      return absl::UnavailableError(absl::StrCat("the server of policy ", label,
                                                 " ended at its start (", exit->text, "). Its log ",
                                                 log, " ends:\n", LastLines(log, 15)));
    }
    if (SteadyClock::now() > deadline) {
      return absl::UnavailableError(absl::StrCat("the server of policy ", label,
                                                 " did not open a port within ",
                                                 options_.server_start_timeout_s, " s; see ", log));
    }
  }
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(port_file));
  const std::string port(absl::StripAsciiWhitespace(text));
  const std::string address =
      port.find(':') == std::string::npos ? absl::StrCat("127.0.0.1:", port) : port;
  servers_.emplace(policy, Server{std::move(process), address, log});
  return absl::OkStatus();
}

absl::Status Sweep::StartServers(const std::vector<const PlannedUnit*>& pending) {
  if (!options_.server.empty()) return absl::OkStatus();
  std::set<std::string> policies;
  for (const PlannedUnit* unit : pending) {
    if (!RunsInWorker(unit->config.policy)) policies.insert(unit->config.policy);
  }
  for (const std::string& policy : policies) RS_RETURN_IF_ERROR(StartServer(policy));
  return absl::OkStatus();
}

absl::StatusOr<ChildProcess> Sweep::StartWorker(const PlannedUnit& unit) {
  RS_ASSIGN_OR_RETURN(const std::string program, FindProgram("worker"));
  std::vector<std::string> command = {
      program, "--unit", absl::StrCat(dir_, "/plan/", unit.id, ".yaml"), "--out", UnitDir(unit)};
  if (!RunsInWorker(unit.config.policy)) {
    const std::string& address =
        options_.server.empty() ? servers_.at(unit.config.policy).address : options_.server;
    command.insert(command.end(), {"--server", address});
  }
  if (options_.measure_lag) command.push_back("--lag");
  if (options_.record_joints) command.push_back("--record-joints");
  return ChildProcess::Start(command, ChildEnvironment(), UnitLog(unit));
}

bool Sweep::WaitForEvent(int timeout_ms) {
  std::vector<pollfd> items = {{signals_.fd(), POLLIN, 0}};
  for (const Running& worker : running_) items.push_back({worker.process.exit_fd(), POLLIN, 0});
  for (const auto& [policy, server] : servers_)
    items.push_back({server.process.exit_fd(), POLLIN, 0});
  poll(items.data(), items.size(), timeout_ms);
  return items[0].revents == 0;
}

void Sweep::Collect(Progress& progress) {
  for (auto worker = running_.begin(); worker != running_.end();) {
    const std::optional<ExitState> exit = worker->process.Poll();
    if (!exit) {
      ++worker;
      continue;
    }
    const PlannedUnit& unit = *worker->unit;
    const bool failed = exit->code != 0 || !Done(unit);
    if (!failed) {
      ++outcome_.completed;
    } else {
      outcome_.failed.push_back(unit.id);
      progress.Say(absl::StrCat("unit ", unit.id, " failed (", exit->text,
                                exit->code == 0 ? ", but it left no DONE" : "", "). Its log ",
                                UnitLog(unit), " ends:\n", LastLines(UnitLog(unit), 12)));
    }
    progress.Finish(unit.id, failed);
    worker = running_.erase(worker);
  }
}

absl::Status Sweep::CheckServers() {
  for (auto& [policy, server] : servers_) {
    if (const std::optional<ExitState> exit = server.process.Poll()) {
      return absl::UnavailableError(absl::StrCat(
          "the server of policy ", PolicyLabel(policy), " ended (", exit->text,
          ") while units needed it. Its log ", server.log, " ends:\n", LastLines(server.log, 15)));
    }
  }
  return absl::OkStatus();
}

absl::Status Sweep::RunPending(std::vector<const PlannedUnit*> pending) {
  std::stable_sort(pending.begin(), pending.end(), [](const PlannedUnit* a, const PlannedUnit* b) {
    return ExpectedCost(*a) > ExpectedCost(*b);
  });
  Progress progress(options_.quiet ? Progress::Output::kNone : Progress::Output::kAutomatic);
  for (const PlannedUnit* unit : pending)
    progress.Expect(unit->id, UnitDir(*unit) + "/episodes.jsonl", unit->EpisodeCount());
  size_t next = 0;
  while (next < pending.size() || !running_.empty()) {
    while (next < pending.size() && static_cast<int>(running_.size()) < options_.workers) {
      const PlannedUnit& unit = *pending[next++];
      RS_ASSIGN_OR_RETURN(ChildProcess process, StartWorker(unit));
      running_.push_back({&unit, std::move(process)});
      progress.Start(unit.id);
    }
    progress.Show();
    if (!WaitForEvent(1000)) {
      outcome_.interrupted = true;
      progress.Say(
          "interrupted: the units that run are stopped; the same command completes them later");
      break;
    }
    Collect(progress);
    if (const absl::Status status = CheckServers(); !status.ok()) {
      progress.End();
      return status;
    }
  }
  progress.End();
  return absl::OkStatus();
}

absl::StatusOr<SweepOutcome> Sweep::Run(const SweepGrid& grid) {
  const auto start = SteadyClock::now();
  const std::string started = UtcNow();
  RS_RETURN_IF_ERROR(MakeDirectories(dir_));
  const Descriptor lock(open((dir_ + "/.lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644));
  if (lock.get() < 0)
    return absl::InternalError(absl::StrCat("cannot write in ", dir_, ": ", strerror(errno)));
  if (flock(lock.get(), LOCK_EX | LOCK_NB) != 0) {
    return absl::FailedPreconditionError(absl::StrCat("another sweep is running in ", dir_,
                                                      "; wait for it or choose another --out"));
  }
  RS_RETURN_IF_ERROR(Prepare(grid));
  std::vector<const PlannedUnit*> pending;
  for (const PlannedUnit& unit : units_) {
    if (Done(unit)) {
      ++outcome_.already_done;
    } else {
      pending.push_back(&unit);
    }
  }
  if (pending.empty()) return outcome_;
  RS_RETURN_IF_ERROR(StartServers(pending));
  const absl::Status status = RunPending(pending);
  running_.clear();  // an interrupted sweep stops its workers before their servers
  for (auto& [policy, server] : servers_) server.process.Terminate(5000);
  outcome_.wall_s = Seconds(SteadyClock::now() - start).count();
  const nlohmann::json launch = {{"started", started},
                                 {"wall_s", outcome_.wall_s},
                                 {"workers", options_.workers},
                                 {"completed", outcome_.completed},
                                 {"failed", outcome_.failed}};
  RS_RETURN_IF_ERROR(AppendLine(dir_ + "/launches.jsonl", launch.dump()));
  RS_RETURN_IF_ERROR(status);
  return outcome_;
}

}  // namespace

absl::StatusOr<SweepOutcome> RunSweep(const SweepGrid& grid, const std::vector<PlannedUnit>& units,
                                      const LaunchOptions& options) {
  return Sweep(units, options).Run(grid);
}

}  // namespace robostress
