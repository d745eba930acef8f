#pragma once

#include <functional>

#include "common/command_line.h"

namespace robostress {

// A subcommand of robostress-policy: what the parser knows and what runs when it was given; returns
// the exit code.
struct PolicyCommand {
  cli::App* app;
  std::function<int()> run;
};

}  // namespace robostress
