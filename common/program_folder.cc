#include "common/program_folder.h"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress {
namespace {

constexpr char kPrefix[] = "robostress-";

}  // namespace

std::string ProgramFolder() {
  if (const char* folder = std::getenv("ROBOSTRESS_BIN"); folder != nullptr && *folder != '\0')
    return folder;
  std::error_code error;
  const std::filesystem::path self = std::filesystem::read_symlink("/proc/self/exe", error);
  return error ? "." : self.parent_path().string();
}

std::vector<std::string> InstalledCommands() {
  std::vector<std::string> commands;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator(ProgramFolder(), error)) {
    std::string name = entry.path().filename().string();
    if (absl::StartsWith(name, kPrefix) && access(entry.path().c_str(), X_OK) == 0) {
      commands.push_back(name.substr(sizeof(kPrefix) - 1));
    }
  }
  std::sort(commands.begin(), commands.end());
  return commands;
}

absl::StatusOr<std::string> FindProgram(const std::string& command) {
  const std::string path = absl::StrCat(ProgramFolder(), "/", kPrefix, command);
  if (command.find('/') == std::string::npos && access(path.c_str(), X_OK) == 0) return path;
  return absl::NotFoundError(
      absl::StrCat("no program ", kPrefix, command, " in ", ProgramFolder(),
                   "; there: ", absl::StrJoin(InstalledCommands(), ", "),
                   ". Build it with ./run build, or name its folder in ROBOSTRESS_BIN"));
}

}  // namespace robostress
