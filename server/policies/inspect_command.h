#pragma once

#include "CLI/CLI.hpp"
#include "server/policies/openpi/checkpoint_commands.h"

namespace robostress {

// policy inspect: what a policy is, what it expects, and everything that is wrong with it.
openpi::PolicyCommand AddInspectCommand(CLI::App& policy);

}  // namespace robostress
