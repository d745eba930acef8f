#include "eval/store/environment.h"

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <memory>
#include <thread>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/program_folder.h"
#include "common/version.h"
#include "eval/plan/build_info.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

namespace fs = std::filesystem;

std::string FirstLineOf(const std::string& command) {
  const std::unique_ptr<FILE, int (*)(FILE*)> pipe(popen(command.c_str(), "r"), pclose);
  char line[256] = "";
  if (pipe == nullptr || std::fgets(line, sizeof(line), pipe.get()) == nullptr) return "";
  return std::string(absl::StripAsciiWhitespace(line));
}

// Of a build in its checkout git's revision now, with "-dirty" when tracked files differ; else that
// which was compiled in.
std::string SourceRevision() {
  const std::string source = SourceFolderOfBuild();
  if (source.empty() || !fs::exists(fs::path(source) / ".git")) return BuildRevision();
  return FirstLineOf(
      absl::StrCat("git -C '", source, "' describe --always --dirty --abbrev=12 2>/dev/null"));
}

std::string Processor() {
  std::ifstream file("/proc/cpuinfo");
  for (std::string line; std::getline(file, line);) {
    if (absl::StartsWith(line, "model name"))
      return std::string(absl::StripAsciiWhitespace(line.substr(line.find(':') + 1)));
  }
  return "unknown";
}

}  // namespace

absl::Status WriteEnvironment(const std::string& run_dir) {
  const nlohmann::json record = {
      {"robostress", BuildVersion()}, {"revision", SourceRevision()},
      {"compiler", kCompiler},        {"build_type", kBuildType},
      {"sanitizers", kSanitizers},    {"mujoco", kMujocoVersion},
      {"torch", kTorchVersion},       {"grpc", kGrpcVersion},
      {"processor", Processor()},     {"cores", std::thread::hardware_concurrency()}};
  return WriteFileAtomically(run_dir + "/environment.json", record.dump(2) + "\n");
}

}  // namespace robostress
