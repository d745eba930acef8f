#pragma once

#include <sys/types.h>

#include <map>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"

namespace robostress {

// How a child ended.
struct ExitState {
  int code = 0;      // exit code, or 128 + signal
  int signal = 0;    // that ended it; 0: none
  std::string text;  // "exit code 3", "killed by signal 9 (Killed)"
};

// A running child process. It dies with its parent (PR_SET_PDEATHSIG) and is terminated by the
// destructor.
class ChildProcess {
 public:
  // Runs `command` (command[0] is a path) with standard output and error appended to `log_file`,
  // those of this process where it is empty, and the variables of `environment` added to this
  // process's own. A command that cannot be run says so there and ends with 127.
  static absl::StatusOr<ChildProcess> Start(const std::vector<std::string>& command,
                                            const std::map<std::string, std::string>& environment,
                                            const std::string& log_file);
  ChildProcess(ChildProcess&& other) noexcept;
  ChildProcess& operator=(ChildProcess&& other) noexcept;
  ~ChildProcess();

  pid_t pid() const { return pid_; }
  int exit_fd() const { return pidfd_; }  // readable (poll) once the child has ended
  // How it ended, or nothing while it runs.
  std::optional<ExitState> Poll();
  // How it ended; waits for that.
  ExitState WaitForEnd() { return *Wait(-1); }
  // SIGTERM, then SIGKILL after `grace_ms`; waits for the end.
  ExitState Terminate(int grace_ms);

 private:
  ChildProcess(pid_t pid, int pidfd) : pid_(pid), pidfd_(pidfd) {}
  std::optional<ExitState> Wait(int timeout_ms);
  pid_t pid_ = -1;
  int pidfd_ = -1;
  std::optional<ExitState> exit_;
};

// The last `lines` lines of a text file, or a sentence saying why there are none.
std::string LastLines(const std::string& file, int lines);

}  // namespace robostress
