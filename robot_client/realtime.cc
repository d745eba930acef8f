#include "robot_client/realtime.h"

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>

#include <cerrno>
#include <cstring>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress {
namespace {

// Touches the stack that ticks will use, so that none of its pages is faulted in later.
void TouchStack() {
  constexpr size_t kBytes = 256 * 1024;
  char stack[kBytes];
  for (size_t i = 0; i < kBytes; i += 4096) *static_cast<volatile char*>(stack + i) = 0;
}

}  // namespace

std::string MakeRealtime(const RealtimeOptions& options) {
  std::vector<std::string> said;
  if (options.lock_memory) {
    said.push_back(mlockall(MCL_CURRENT | MCL_FUTURE) == 0
                       ? "memory locked"
                       : absl::StrCat("memory not locked (", std::strerror(errno),
                                      "; raise memlock in /etc/security/limits.conf)"));
  }
  if (options.priority > 0) {
    sched_param parameter{};
    parameter.sched_priority = options.priority;
    const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameter);
    said.push_back(error == 0
                       ? absl::StrCat("SCHED_FIFO ", options.priority)
                       : absl::StrCat("ordinary priority (SCHED_FIFO: ", std::strerror(error),
                                      "; raise rtprio in /etc/security/limits.conf)"));
  }
  if (options.cpu >= 0) {
    cpu_set_t set;
    CPU_ZERO(&set);
    CPU_SET(static_cast<size_t>(options.cpu), &set);
    const int error = pthread_setaffinity_np(pthread_self(), sizeof(set), &set);
    said.push_back(
        error == 0 ? absl::StrCat("processor ", options.cpu)
                   : absl::StrCat("any processor (", options.cpu, ": ", std::strerror(error), ")"));
  }
  TouchStack();
  return absl::StrJoin(said, ", ");
}

}  // namespace robostress
