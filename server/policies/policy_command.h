#pragma once

#include <functional>

#include "CLI/CLI.hpp"

namespace robostress {

// A subcommand of robostress-policy: what the parser knows and what runs when it was given; returns
// the exit code.
struct PolicyCommand {
  CLI::App* app;
  std::function<int()> run;
};

}  // namespace robostress
