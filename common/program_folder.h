#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// The folder of the other programs: ROBOSTRESS_BIN if set, else that of the running program.
std::string ProgramFolder();
// Full path of robostress-COMMAND; not found: the folder that was searched and the programs that
// are there.
absl::StatusOr<std::string> FindProgram(const std::string& command);
// Commands that ProgramFolder() holds, sorted: "report", "serve", "sweep" ...
std::vector<std::string> InstalledCommands();

}  // namespace robostress
