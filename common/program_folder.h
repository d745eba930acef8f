#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// The folder of the other programs: ROBOSTRESS_BIN if set, else that of the running program.
std::string ProgramFolder();
// The source tree, for a program that lies in a build folder; empty for one that was installed.
std::string SourceFolderOfBuild();
// A file or folder beside the program's own: "lib/dri" is PREFIX/lib/dri of PREFIX/bin/PROGRAM.
std::string PathInPrefix(const std::string& path);
// A file or folder that comes with the programs, by its path in the source:
// "server/models/weights". Of a program that was built: that in the source tree. Of one that was
// installed: that in
// ../share/robostress beside the program's folder.
std::string DataPath(const std::string& path_in_source);
// Full path of robostress-COMMAND; not found: the folder that was searched and the programs that
// are there.
absl::StatusOr<std::string> FindProgram(const std::string& command);
// Commands that ProgramFolder() holds, sorted: "report", "serve", "sweep" ...
std::vector<std::string> InstalledCommands();

}  // namespace robostress
