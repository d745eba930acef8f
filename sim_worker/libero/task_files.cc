#include "sim_worker/libero/task_files.h"

#include <vector>

#include "absl/strings/str_cat.h"
#include "common/libero/bddl.h"
#include "common/libero/fixtures.h"
#include "common/libero/init_states.h"
#include "common/libero/task_folder.h"
#include "common/status_macros.h"
#include "sim_worker/libero/libero_sim_task.h"
#include "sim_worker/libero/libero_task.h"
#include "sim_worker/libero/task_doubts.h"

namespace robostress::libero {
namespace {

absl::Status CheckTask(int task, const std::vector<std::string>& names, const std::string& suite) {
  const int count = static_cast<int>(names.size());
  if (task >= 0 && task < count) return absl::OkStatus();
  return absl::OutOfRangeError(absl::StrCat("task ", task, " of suite '", suite,
                                            "' does not exist; tasks are 0 to ", count - 1));
}

// LIBERO's benchmark derives LIBERO-90's from the names of its files, whose wording differs in
// four; where a file says nothing its name does.
std::string FolderInstruction(const LiberoTaskFolder& folder, const std::string& task,
                              const BddlProblem& problem) {
  const bool by_name = folder.SuiteOfFiles() == "libero_90" || problem.language.empty();
  return by_name ? LiberoInstruction(task) : problem.language;
}

}  // namespace

absl::StatusOr<TaskFiles> FindTaskFiles(const LiberoPaths& paths, const UnitConfig& unit,
                                        int task) {
  TaskFiles files;
  if (unit.libero_tasks.empty()) {
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, LiberoTaskNames(unit.suite));
    RS_RETURN_IF_ERROR(CheckTask(task, names, unit.suite));
    files.name = names[task];
    files.instruction = LiberoInstruction(files.name);
    const std::string stem = absl::StrCat(unit.suite, "/", files.name);
    files.bddl = absl::StrCat(paths.libero, "/bddl_files/", stem, ".bddl");
    files.initial_states = absl::StrCat(paths.libero, "/init_files/", stem, ".pruned_init");
    return files;
  }
  RS_ASSIGN_OR_RETURN(const LiberoTaskFolder folder, ReadLiberoTaskFolder(unit.libero_tasks));
  RS_RETURN_IF_ERROR(CheckTask(task, folder.tasks, folder.suite));
  files.name = folder.tasks[task];
  files.bddl = absl::StrCat(folder.path, "/", files.name, ".bddl");
  RS_ASSIGN_OR_RETURN(const BddlProblem problem, ReadBddl(files.bddl));
  files.instruction = FolderInstruction(folder, files.name, problem);
  files.initial_states = InitialStatesOf(folder, files.name);
  if (files.initial_states.empty()) {
    return absl::NotFoundError(absl::StrCat(files.bddl, ": ", NoInitialStates(folder, files.name)));
  }
  return files;
}

}  // namespace robostress::libero

namespace robostress {

absl::StatusOr<int> CountInitialStates(const UnitConfig& unit, int task) {
  libero::LiberoPaths paths;
  if (unit.libero_tasks.empty()) {
    RS_ASSIGN_OR_RETURN(paths, libero::FindLibero(unit.libero_root, unit.robosuite_root));
  }
  RS_ASSIGN_OR_RETURN(const libero::TaskFiles files, libero::FindTaskFiles(paths, unit, task));
  RS_ASSIGN_OR_RETURN(const libero::InitStates states,
                      libero::ReadInitStates(files.initial_states));
  return states.rows;
}

absl::Status CheckLiberoTasks(const UnitConfig& unit) {
  RS_ASSIGN_OR_RETURN(const libero::LiberoPaths paths,
                      libero::FindLibero(unit.libero_root, unit.robosuite_root));
  for (const int task : unit.tasks) {
    RS_ASSIGN_OR_RETURN(const libero::TaskFiles files, libero::FindTaskFiles(paths, unit, task));
    RS_ASSIGN_OR_RETURN(const libero::BddlProblem problem, libero::ReadBddl(files.bddl));
    if (const auto problem_class = libero::FindProblemClass(problem.name); problem_class.ok())
      RS_RETURN_IF_ERROR(libero::CheckFixturesPlaced(problem, *problem_class));
    RS_ASSIGN_OR_RETURN(const libero::InitStates states,
                        libero::ReadInitStates(files.initial_states));
    RS_RETURN_IF_ERROR(libero::CheckEpisodeRows(states, unit.first_initial_state, unit.episodes));
  }
  // The files of LIBERO's own suites are checked by setup.
  if (unit.libero_tasks.empty() && !NamesFixtureTable(unit.libero_fixtures))
    return absl::OkStatus();
  for (size_t i = 1; i < unit.tasks.size(); ++i)  // the first is made right after this
    RS_RETURN_IF_ERROR(libero::LiberoSimTask::Check(unit, unit.tasks[i]));
  return absl::OkStatus();
}

absl::Status CheckLiberoFound(const UnitConfig& unit) {
  return libero::FindLibero(unit.libero_root, unit.robosuite_root).status();
}

absl::StatusOr<std::vector<LiberoTaskLine>> LiberoTaskLines(const UnitConfig& unit) {
  std::vector<LiberoTaskLine> lines;
  if (unit.libero_tasks.empty()) {
    RS_ASSIGN_OR_RETURN(const std::vector<std::string> names, libero::LiberoTaskNames(unit.suite));
    for (const std::string& name : names) lines.push_back({name, libero::LiberoInstruction(name)});
    return lines;
  }
  RS_ASSIGN_OR_RETURN(const LiberoTaskFolder folder, ReadLiberoTaskFolder(unit.libero_tasks));
  for (const std::string& task : folder.tasks) {
    const auto problem = libero::ReadBddl(absl::StrCat(folder.path, "/", task, ".bddl"));
    LiberoTaskLine line = {task, "", problem.status()};
    if (problem.ok()) line.instruction = libero::FolderInstruction(folder, task, *problem);
    lines.push_back(std::move(line));
  }
  return lines;
}

}  // namespace robostress
