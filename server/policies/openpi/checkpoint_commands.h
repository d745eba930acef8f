#pragma once

#include "server/policies/policy_command.h"

namespace robostress::openpi {

// policy check: compares every intermediate of a network with expected values.
PolicyCommand AddCheckCommand(cli::App& policy);

// policy generate: writes a checkpoint of random weights.
PolicyCommand AddGenerateCommand(cli::App& policy);

// policy load: loads a checkpoint and prints time and memory as one JSON object.
PolicyCommand AddLoadCommand(cli::App& policy);

}  // namespace robostress::openpi
