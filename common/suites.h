#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

struct UnitConfig;  // common/unit_config.h

// What a sweep must know of a suite before a simulator starts.
struct SuiteInfo {
  std::string name;   // "tabletop_goal", "libero_goal"
  std::string title;  // "Goal"
  int num_tasks = 10;
  int horizon = 0;  // control steps after the settle steps
  // Reproducible states per task; 0-19 report, 40-49 dev. Of a task folder 10,000 at most:
  // how many a task has its file says.
  int num_initial_states = 50;
  bool needs_libero = false;    // reads LIBERO's own files
  std::string robot = "panda";  // common/unit/robots.h
  bool states_go_on = false;    // the states of a task begin where those of the task before it end
};

// The four embedded suites, LIBERO's four, then those of other robots, in the order of the tables.
const std::vector<SuiteInfo>& AllSuites();
// Makes a folder of LIBERO tasks (common/libero/task_folder.h) a suite of this process, named as
// the folder is, and says the name. Its horizon is that of the suite from whose name and '_' its
// name begins (libero_goal_swap: libero_goal), else 400, openpi's for LIBERO-90. Again with the
// same folder changes nothing; a name that another suite has is InvalidArgument. Any thread.
absl::StatusOr<std::string> AddTaskFolder(const std::string& folder);
// The folder of a suite that AddTaskFolder made; empty for others.
std::string TaskFolderOf(const std::string& suite);
// One of LIBERO's own four, which nano-libero has learned; not those of task folders.
bool IsLiberosOwn(const std::string& suite);
// Names of the suites of a robot; those of task folders last.
std::vector<std::string> SuitesOf(const std::string& robot);
// Stays valid. A task folder's suite is found once it was added.
const SuiteInfo* FindSuite(const std::string& name);
// Control steps of an episode at most: unit.horizon, else the suite's; 0 where neither says.
int HorizonOf(const UnitConfig& unit);

}  // namespace robostress
