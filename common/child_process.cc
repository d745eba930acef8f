#include "common/child_process.h"

#include <fcntl.h>
#include <poll.h>
#include <signal.h>
#include <string.h>
#include <sys/prctl.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdlib>
#include <fstream>
#include <utility>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

extern char** environ;

namespace robostress {
namespace {

absl::Status ErrnoStatus(const std::string& what) {
  return absl::InternalError(absl::StrCat(what, ": ", strerror(errno)));
}

}  // namespace

absl::StatusOr<ChildProcess> ChildProcess::Start(
    const std::vector<std::string>& command, const std::map<std::string, std::string>& environment,
    const std::string& log_file) {
  // Everything that allocates happens before fork: the child may only call async-signal-safe
  // functions.
  std::vector<std::string> variables;
  for (char** variable = environ; *variable != nullptr; ++variable) {
    const std::string name = std::string(*variable).substr(0, std::string(*variable).find('='));
    if (environment.count(name) == 0) variables.emplace_back(*variable);
  }
  for (const auto& [name, value] : environment) variables.push_back(absl::StrCat(name, "=", value));
  std::vector<char*> argv, envp;
  for (const std::string& argument : command) argv.push_back(const_cast<char*>(argument.c_str()));
  for (const std::string& variable : variables) envp.push_back(const_cast<char*>(variable.c_str()));
  argv.push_back(nullptr);
  envp.push_back(nullptr);

  const std::string cannot = absl::StrCat("cannot run ", command[0], ": ");
  int log = -1;
  if (!log_file.empty()) {
    log = open(log_file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
    if (log < 0) return ErrnoStatus(absl::StrCat("cannot open the log ", log_file));
  }
  const int null = open("/dev/null", O_RDONLY | O_CLOEXEC);
  const pid_t parent = getpid();
  const pid_t pid = fork();
  if (pid == 0) {
    prctl(PR_SET_PDEATHSIG, SIGTERM);
    if (getppid() != parent) _exit(127);  // the parent ended before prctl
    dup2(null, STDIN_FILENO);
    if (log >= 0) {
      dup2(log, STDOUT_FILENO);
      dup2(log, STDERR_FILENO);
    }
    sigset_t none;
    sigemptyset(&none);
    sigprocmask(SIG_SETMASK, &none, nullptr);
    execve(argv[0], argv.data(), envp.data());
    for (const char* text : {cannot.c_str(), strerrordesc_np(errno), "\n"}) {
      if (write(STDERR_FILENO, text, strlen(text)) < 0) break;
    }
    _exit(127);
  }
  const int fork_errno = errno;
  if (log >= 0) close(log);
  if (null >= 0) close(null);
  errno = fork_errno;
  if (pid < 0) return ErrnoStatus(absl::StrCat("cannot start ", command[0]));
  // Not glibc's wrapper: 2.36 declares it without C linkage.
  const int pidfd = static_cast<int>(syscall(SYS_pidfd_open, pid, 0));
  if (pidfd < 0) {
    const absl::Status status = ErrnoStatus(absl::StrCat("pidfd_open of ", command[0]));
    kill(pid, SIGKILL);
    waitpid(pid, nullptr, 0);
    return status;
  }
  return ChildProcess(pid, pidfd);
}

ChildProcess::ChildProcess(ChildProcess&& other) noexcept
    : pid_(std::exchange(other.pid_, -1)),
      pidfd_(std::exchange(other.pidfd_, -1)),
      exit_(std::move(other.exit_)) {}

ChildProcess& ChildProcess::operator=(ChildProcess&& other) noexcept {
  std::swap(pid_, other.pid_);
  std::swap(pidfd_, other.pidfd_);
  std::swap(exit_, other.exit_);
  return *this;
}

ChildProcess::~ChildProcess() {
  if (pid_ > 0 && !exit_) Terminate(2000);
  if (pidfd_ >= 0) close(pidfd_);
}

std::optional<ExitState> ChildProcess::Wait(int timeout_ms) {
  if (exit_) return exit_;
  pollfd item{pidfd_, POLLIN, 0};
  poll(&item, 1, timeout_ms);
  int status = 0;
  if (waitpid(pid_, &status, WNOHANG) != pid_) return std::nullopt;
  if (WIFEXITED(status)) {
    exit_ = ExitState{WEXITSTATUS(status), 0, absl::StrCat("exit code ", WEXITSTATUS(status))};
  } else {
    const int signal = WTERMSIG(status);
    exit_ = ExitState{128 + signal, signal,
                      absl::StrCat("killed by signal ", signal, " (", strsignal(signal), ")")};
  }
  return exit_;
}

std::optional<ExitState> ChildProcess::Poll() { return Wait(0); }

ExitState ChildProcess::Terminate(int grace_ms) {
  if (exit_) return *exit_;
  kill(pid_, SIGTERM);
  if (std::optional<ExitState> exit = Wait(grace_ms)) return *exit;
  kill(pid_, SIGKILL);
  while (true) {
    if (std::optional<ExitState> exit = Wait(-1)) return *exit;
  }
}

std::string LastLines(const std::string& file, int lines) {
  std::ifstream stream(file);
  if (!stream) return absl::StrCat("(cannot read ", file, ")");
  std::vector<std::string> kept;
  for (std::string line; std::getline(stream, line);) {
    if (static_cast<int>(kept.size()) == lines) kept.erase(kept.begin());
    kept.push_back(line);
  }
  return kept.empty() ? absl::StrCat("(", file, " is empty)") : absl::StrJoin(kept, "\n");
}

}  // namespace robostress
