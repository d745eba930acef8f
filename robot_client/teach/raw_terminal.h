#pragma once

#include <termios.h>

#include <memory>

#include "absl/status/statusor.h"

namespace robostress {

// A terminal that gives every key at once and shows none. It is as it was when the object goes, and
// also when the process dies of a fault's signal or of Ctrl-\; nothing helps against SIGKILL
// (`reset` does afterwards). Ctrl-C still comes as a signal, Ctrl-Z does nothing: a stopped client
// would leave the arm to itself. One object at a time.
class RawTerminal {
 public:
  // FAILED_PRECONDITION where `descriptor` is no terminal.
  static absl::StatusOr<std::unique_ptr<RawTerminal>> Open(int descriptor);
  ~RawTerminal();
  RawTerminal(const RawTerminal&) = delete;
  RawTerminal& operator=(const RawTerminal&) = delete;

 private:
  RawTerminal() = default;
};

}  // namespace robostress
