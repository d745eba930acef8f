#pragma once

#include "server/policies/policy_command.h"

namespace robostress {

// policy inspect: what a policy is, what it expects, and everything that is wrong with it.
PolicyCommand AddInspectCommand(cli::App& policy);

}  // namespace robostress
