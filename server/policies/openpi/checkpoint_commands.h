#pragma once

#include "server/policies/policy_command.h"

namespace robostress::openpi {

// policy check: compares every intermediate of a network with expected values.
PolicyCommand AddCheckCommand(CLI::App& policy);

// policy generate: writes a checkpoint of random weights.
PolicyCommand AddGenerateCommand(CLI::App& policy);

// policy load: loads a checkpoint and prints time and memory as one JSON object.
PolicyCommand AddLoadCommand(CLI::App& policy);

}  // namespace robostress::openpi
