#include "common/program_folder.h"

#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;

constexpr char kPrefix[] = "robostress-";
constexpr char kHome[] = "CMAKE_HOME_DIRECTORY:INTERNAL=";
constexpr int kDeepest = 3;  // build/release/test_bin/fakes

fs::path OwnFolder() {
  std::error_code error;
  const fs::path self = fs::read_symlink("/proc/self/exe", error);
  return error ? fs::path(".") : self.parent_path();
}

// The source tree that the build folder around `folder` was configured from; empty where there is
// no such folder.
fs::path SourceFolder(fs::path folder) {
  for (int depth = 0; depth < kDeepest; ++depth) {
    folder = folder.parent_path();
    std::ifstream cache(folder / "CMakeCache.txt");
    for (std::string line; std::getline(cache, line);) {
      if (absl::StartsWith(line, kHome)) return line.substr(sizeof(kHome) - 1);
    }
  }
  return {};
}

}  // namespace

std::string ProgramFolder() {
  if (const char* folder = std::getenv("ROBOSTRESS_BIN"); folder != nullptr && *folder != '\0')
    return folder;
  return OwnFolder().string();
}

std::string SourceFolderOfBuild() { return SourceFolder(OwnFolder()).string(); }

std::string PathInPrefix(const std::string& path) {
  return (OwnFolder().parent_path() / path).string();
}

std::string DataPath(const std::string& path_in_source) {
  const std::string source = SourceFolderOfBuild();
  return source.empty() ? PathInPrefix("share/robostress/" + path_in_source)
                        : (fs::path(source) / path_in_source).string();
}

std::vector<std::string> InstalledCommands() {
  std::vector<std::string> commands;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(ProgramFolder(), error)) {
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
