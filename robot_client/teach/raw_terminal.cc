#include "robot_client/teach/raw_terminal.h"

#include <unistd.h>

#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstring>

#include "absl/strings/str_cat.h"

namespace robostress {
namespace {

// What a handler of a deadly signal restores: it may touch neither a lock nor an object.
termios before;
std::atomic<int> raw_descriptor{-1};
constexpr int kDeadly[] = {SIGSEGV, SIGABRT, SIGBUS, SIGFPE, SIGILL, SIGQUIT};

void Restore() {
  const int descriptor = raw_descriptor.exchange(-1);
  if (descriptor >= 0) tcsetattr(descriptor, TCSANOW, &before);
}

void RestoreAndDie(int number) {
  Restore();
  std::signal(number, SIG_DFL);
  raise(number);
}

}  // namespace

absl::StatusOr<std::unique_ptr<RawTerminal>> RawTerminal::Open(int descriptor) {
  if (tcgetattr(descriptor, &before) != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat("--by keyboard needs a terminal, standard input is none (",
                     std::strerror(errno), "); run robot_client in a terminal, or --by gamepad"));
  }
  termios raw = before;
  raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);
  raw.c_cc[VMIN] = 1;
  raw.c_cc[VTIME] = 0;
  raw.c_cc[VSUSP] = _POSIX_VDISABLE;
  raw_descriptor = descriptor;
  for (const int number : kDeadly) std::signal(number, RestoreAndDie);
  if (tcsetattr(descriptor, TCSANOW, &raw) != 0) {
    Restore();
    return absl::UnavailableError(
        absl::StrCat("the terminal does not give single keys: ", std::strerror(errno)));
  }
  return std::unique_ptr<RawTerminal>(new RawTerminal);
}

RawTerminal::~RawTerminal() {
  Restore();
  for (const int number : kDeadly) std::signal(number, SIG_DFL);
}

}  // namespace robostress
