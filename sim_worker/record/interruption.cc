#include "sim_worker/record/interruption.h"

#include <signal.h>

#include <thread>
#include <utility>

namespace robostress {
namespace {

sigset_t Interruptions() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGTERM);
  return set;
}

}  // namespace

void HoldInterruptions() {
  const sigset_t set = Interruptions();
  pthread_sigmask(SIG_BLOCK, &set, nullptr);
}

void OnInterruption(std::function<void(int signal)> end) {
  std::thread([end = std::move(end)] {
    const sigset_t set = Interruptions();
    int signal = 0;
    if (sigwait(&set, &signal) == 0) end(signal);
  }).detach();
}

}  // namespace robostress
