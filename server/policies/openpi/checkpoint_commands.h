#pragma once

#include <functional>

#include "CLI/CLI.hpp"

namespace robostress::openpi {

// A subcommand of robostress-policy: what the parser knows and what runs when it was given; returns
// the exit code.
struct PolicyCommand {
  CLI::App* app;
  std::function<int()> run;
};

// policy generate: writes a checkpoint of random weights.
PolicyCommand AddGenerateCommand(CLI::App& policy);

// policy load: loads a checkpoint and prints time and memory as one JSON object.
PolicyCommand AddLoadCommand(CLI::App& policy);

}  // namespace robostress::openpi
