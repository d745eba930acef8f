#pragma once

#include "absl/status/status.h"

namespace robostress {

// Exit codes of the programs that run or check a grid. 128 + signal: stopped; the same command goes
// on.
inline constexpr int kExitDone = 0;
inline constexpr int kExitUnitFailed = 1;    // or another error; the rest is done
inline constexpr int kExitWrongCommand = 2;  // nothing was begun
inline constexpr int kExitBadStore = 3;      // `robostress store`: damage or conflicts, all listed
inline constexpr int kExitTryAgain = 75;     // EX_TEMPFAIL: nothing is wrong with the units

// After an error: whether the command was wrong.
inline int ExitCodeOfError(const absl::Status& status) {
  return absl::IsInvalidArgument(status) ? kExitWrongCommand : kExitUnitFailed;
}

}  // namespace robostress
