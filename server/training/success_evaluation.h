#pragma once

#include <cstdint>
#include <string>

#include "absl/status/statusor.h"

namespace robostress {

// Success of the policy in training, as a command of the user's measured it.
struct SuccessCount {
  int64_t successes = 0, episodes = 0;
};

// Runs `command` in a shell with {weights}, {step} and {out} replaced, where {out} is a folder for
// its results, and counts the episodes it left there (every episodes.jsonl below {out}, which is
// what `robostress sweep --out {out}` writes). Training knows no simulator: it starts a program
// that does. Blocks until the command has ended; its output goes where training's goes. The error
// names the command and how it ended, or the line that is not an episode.
absl::StatusOr<SuccessCount> MeasureSuccess(const std::string& command, const std::string& weights,
                                            const std::string& out, int64_t step);

}  // namespace robostress
