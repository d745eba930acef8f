#pragma once

#include <signal.h>

namespace robostress {

// Turns SIGINT and SIGTERM into a readable descriptor for as long as it lives.
class SignalGuard {
 public:
  SignalGuard();
  ~SignalGuard();
  SignalGuard(const SignalGuard&) = delete;
  SignalGuard& operator=(const SignalGuard&) = delete;

  int fd() const { return fd_; }  // readable (poll) once a signal has come
  // The signal that came, 0 while none has.
  int Received();

 private:
  sigset_t previous_;
  int fd_ = -1;
  int received_ = 0;
};

}  // namespace robostress
