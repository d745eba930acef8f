#include "eval/launch/signal_guard.h"

#include <sys/signalfd.h>
#include <unistd.h>

namespace robostress {

SignalGuard::SignalGuard() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGTERM);
  sigprocmask(SIG_BLOCK, &set, &previous_);
  fd_ = signalfd(-1, &set, SFD_CLOEXEC | SFD_NONBLOCK);
}

SignalGuard::~SignalGuard() {
  Received();  // else it would be delivered once it is no longer blocked
  if (fd_ >= 0) close(fd_);
  sigprocmask(SIG_SETMASK, &previous_, nullptr);
}

int SignalGuard::Received() {
  signalfd_siginfo info;
  while (read(fd_, &info, sizeof(info)) == sizeof(info)) {
    if (received_ == 0) received_ = static_cast<int>(info.ssi_signo);
  }
  return received_;
}

}  // namespace robostress
