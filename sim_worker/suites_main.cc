// robostress-suites: lists suites, tasks and instructions; draws contact sheets of first frames.

#include <unistd.h>

#include <cstdio>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/run_main.h"
#include "common/status_macros.h"
#include "common/suites.h"
#include "nlohmann/json.hpp"
#include "sim_worker/contact_sheet.h"
#include "sim_worker/libero/libero_task.h"
#include "sim_worker/suites/embedded_task.h"

namespace robostress {
namespace {

struct CommandLine {
  std::string suite, sheets, libero_root, robosuite_root;
  std::vector<std::string> task_folders, folder_suites;
  bool json = false, libero = false;
  int size = 176, initial_state = 0;
};

bool Wanted(const CommandLine& line, const SuiteInfo& info) {
  if (!line.suite.empty()) return line.suite == info.name;
  if (!line.folder_suites.empty() && !line.libero) return false;
  return !line.libero || info.needs_libero;
}

// In words; of a task folder its files say how many, each task of its own.
std::string StatesOf(const SuiteInfo& info) {
  if (!TaskFolderOf(info.name).empty()) return "";
  return absl::StrCat(", ", info.num_initial_states, " initial states");
}

UnitConfig UnitOf(const CommandLine& line, const SuiteInfo& info) {
  UnitConfig unit;
  unit.suite = info.name;
  unit.libero_root = line.libero_root;
  unit.robosuite_root = line.robosuite_root;
  unit.libero_tasks = TaskFolderOf(info.name);
  unit.first_initial_state = line.initial_state;
  unit.episodes = 1;
  return unit;
}

// Empty for a suite whose tasks this build does not know.
// None of LIBERO's own suites where LIBERO is not there.
absl::StatusOr<std::vector<LiberoTaskLine>> TasksOf(const CommandLine& line,
                                                    const SuiteInfo& info) {
  std::vector<LiberoTaskLine> tasks;
  if (const SuiteSpec* spec = FindSuiteSpec(info.name)) {
    for (const TaskSpec& task : spec->tasks)
      tasks.push_back({TaskName(task.instruction), task.instruction, absl::OkStatus()});
  } else if (info.needs_libero) {
    absl::StatusOr<std::vector<LiberoTaskLine>> found = LiberoTaskLines(UnitOf(line, info));
    if (found.ok() || !TaskFolderOf(info.name).empty()) return found;
  }
  return tasks;
}

// All suites, those of task folders last.
std::vector<SuiteInfo> Suites(const CommandLine& line) {
  std::vector<SuiteInfo> suites;
  for (const SuiteInfo& info : AllSuites()) {
    if (Wanted(line, info)) suites.push_back(info);
  }
  for (const std::string& name : line.folder_suites) suites.push_back(*FindSuite(name));
  return suites;
}

// ", needs ..." where LIBERO's files are needed and not found.
std::string NeedOf(const CommandLine& line, const SuiteInfo& info) {
  if (!info.needs_libero || CheckLiberoFound(UnitOf(line, info)).ok()) return "";
  return ", needs `robostress libero setup`";
}

absl::Status PrintText(const CommandLine& line) {
  for (const SuiteInfo& info : Suites(line)) {
    std::printf("%s  (%s, %d tasks, horizon %d%s%s%s)\n", info.name.c_str(), info.title.c_str(),
                info.num_tasks, info.horizon, StatesOf(info).c_str(), NeedOf(line, info).c_str(),
                info.robot == "panda" ? "" : absl::StrCat(", --robot ", info.robot).c_str());
    int number = 0;
    RS_ASSIGN_OR_RETURN(const std::vector<LiberoTaskLine> tasks, TasksOf(line, info));
    for (const LiberoTaskLine& task : tasks) {
      std::string states;
      if (!task.read.ok()) {
        states = absl::StrCat(task.name, "  (", task.read.message(), ")");
      } else if (!TaskFolderOf(info.name).empty()) {
        const absl::StatusOr<int> count = CountInitialStates(UnitOf(line, info), number);
        states = count.ok() ? absl::StrCat("  (", *count, " initial states)")
                            : absl::StrCat("  (", count.status().message(), ")");
      }
      std::printf("  %d  %s%s\n", number++, task.instruction.c_str(), states.c_str());
    }
  }
  return absl::OkStatus();
}

absl::Status PrintJson(const CommandLine& line) {
  nlohmann::json out = nlohmann::json::array();
  for (const SuiteInfo& info : Suites(line)) {
    nlohmann::json suite = {{"name", info.name},
                            {"title", info.title},
                            {"num_tasks", info.num_tasks},
                            {"horizon", info.horizon},
                            {"needs_libero", info.needs_libero},
                            {"robot", info.robot}};
    RS_ASSIGN_OR_RETURN(const std::vector<LiberoTaskLine> tasks, TasksOf(line, info));
    const bool folder = !TaskFolderOf(info.name).empty();
    if (!folder) suite["num_initial_states"] = info.num_initial_states;
    for (const LiberoTaskLine& task : tasks) {
      nlohmann::json entry = {{"name", task.name}, {"instruction", task.instruction}};
      if (!task.read.ok()) entry["error"] = task.read.message();
      if (folder) {
        const auto count =
            CountInitialStates(UnitOf(line, info), static_cast<int>(suite["tasks"].size()));
        entry["num_initial_states"] = count.value_or(0);
      }
      suite["tasks"].push_back(entry);
    }
    out.push_back(suite);
  }
  std::printf("%s\n", out.dump(2).c_str());
  return absl::OkStatus();
}

FirstFrame GreyFrame(int size) {
  return {"not drawn", {size, size, std::vector<uint8_t>(3 * size * size, 200)}};
}

// Of unit.tasks, which is one.
absl::StatusOr<FirstFrame> DrawTask(const UnitConfig& unit, const SuiteInfo& info, int size) {
  const int task = unit.tasks.front();
  if (info.needs_libero) {
    RS_RETURN_IF_ERROR(CheckLiberoTasks(unit));  // drawing takes seconds
    std::fprintf(stderr, "%s: drawing task %d, the last is %d\n", info.name.c_str(), task,
                 info.num_tasks - 1);
  }
  return RenderFirstFrame(unit, task, size);
}

// FOLDER/SUITE.svg of the suite that was asked for, of LIBERO's or of every embedded one.
absl::Status WriteSheets(const CommandLine& line) {
  // Drawing takes minutes: what does not depend on it comes first.
  const std::string probe = absl::StrCat(line.sheets, "/.probe.", getpid());
  absl::Status writes = MakeDirectories(line.sheets);
  if (writes.ok()) writes = WriteFileAtomically(probe, "");
  if (!writes.ok()) {
    return absl::Status(writes.code(), absl::StrCat("--sheet ", line.sheets, ": ", writes.message(),
                                                    "; give a folder that can be written"));
  }
  unlink(probe.c_str());
  std::string missing;
  for (const SuiteInfo& info : Suites(line)) {
    if (info.robot != "panda") continue;
    const bool shown = line.libero || !line.folder_suites.empty();  // what needs LIBERO's files
    if (line.suite.empty() && info.needs_libero != shown) continue;
    UnitConfig unit = UnitOf(line, info);
    if (info.needs_libero) RS_RETURN_IF_ERROR(CheckLiberoFound(unit));
    std::vector<FirstFrame> frames(info.num_tasks);
    int drawn = 0;
    for (int task = 0; task < info.num_tasks; ++task) {
      unit.tasks = {task};
      absl::StatusOr<FirstFrame> frame = DrawTask(unit, info, line.size);
      if (!frame.ok()) {
        if (absl::IsUnavailable(frame.status())) return frame.status();  // nothing can be drawn
        absl::StrAppend(&missing, "\n  ", info.name, " task ", task, ": ",
                        frame.status().message());
        frame = GreyFrame(line.size);
      } else {
        ++drawn;
      }
      frames[task] = *std::move(frame);
    }
    if (drawn == 0) continue;
    const std::string title = absl::StrCat(info.name, ", initial state ", line.initial_state);
    RS_ASSIGN_OR_RETURN(const std::string svg, ContactSheetSvg(title, frames));
    const std::string file = absl::StrCat(line.sheets, "/", info.name, ".svg");
    RS_RETURN_IF_ERROR(WriteFileAtomically(file, svg));
    std::printf("%s\n", file.c_str());
  }
  if (missing.empty()) return absl::OkStatus();
  return absl::FailedPreconditionError(absl::StrCat("not drawn:", missing));
}

int Run(CommandLine& line) {
  for (const std::string& folder : line.task_folders) {
    absl::StatusOr<std::string> suite = AddTaskFolder(folder);
    if (!suite.ok()) {
      std::fprintf(stderr, "suites: --libero-tasks: %s\n",
                   std::string(suite.status().message()).c_str());
      return 2;
    }
    line.folder_suites.push_back(*std::move(suite));
  }
  if (!line.suite.empty() && FindSuite(line.suite) == nullptr) {
    std::fprintf(stderr,
                 "suites: suite '%s' is unknown; `robostress suites` lists those that there are, "
                 "--libero-tasks DIR opens any folder of LIBERO tasks, such as "
                 "bddl_files/libero_90\n",
                 line.suite.c_str());
    return 2;
  }
  const absl::Status status = !line.sheets.empty() ? WriteSheets(line)
                              : line.json          ? PrintJson(line)
                                                   : PrintText(line);
  if (!status.ok()) std::fprintf(stderr, "suites: %s\n", std::string(status.message()).c_str());
  return status.ok() ? 0 : 1;
}

}  // namespace
}  // namespace robostress

int main(int argc, char** argv) {
  robostress::cli::App app(
      "Lists suites, tasks and instructions; draws contact sheets of their first frames.",
      "robostress suites");
  app.footer(
      "\nExamples\n  robostress suites\n  robostress suites --suite tabletop_goal --json\n  "
      "robostress suites --sheet sheets\n  robostress suites --libero --sheet sheets\n");
  robostress::CommandLine line;
  app.add_option("--suite", line.suite, "Only this one");
  app.add_flag("--libero", line.libero, "Only LIBERO's four");
  app.add_option("--libero-tasks", line.task_folders,
                 "Only this folder of LIBERO tasks (.bddl), as a suite with its name; repeatable, "
                 "and beside "
                 "--libero")
      ->type_name("DIR")
      ->check(robostress::cli::ExistingDirectory())
      ->allow_extra_args(false);
  app.add_flag("--json", line.json, "As JSON");
  app.add_option(
         "--sheet", line.sheets,
         "Write FOLDER/SUITE.svg with the first frame of every task, of the embedded suites, "
         "of --suite, --libero or --libero-tasks")
      ->type_name("FOLDER");
  app.add_option("--size", line.size, "Of a view on the sheet [px]")
      ->check(robostress::cli::Range(16, 512))
      ->capture_default_str();
  app.add_option("--initial-state", line.initial_state, "Shown on the sheet")
      ->capture_default_str();
  app.add_option(
      "--libero-root", line.libero_root,
      "LIBERO checkout, for suites libero_* (default: LIBERO_ROOT, else what `robostress libero "
      "setup` linked)");
  app.add_option("--robosuite-root", line.robosuite_root,
                 "robosuite checkout, for suites libero_*");
  return robostress::RunMain(app, argc, argv, [&] { return robostress::Run(line); });
}
