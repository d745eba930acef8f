#pragma once

#include <string>
#include <vector>

namespace robostress {

struct UnitConfig;  // common/unit_config.h

// What a sweep must know of a suite before a simulator starts.
struct SuiteInfo {
  std::string name;   // "tabletop_goal", "libero_goal"
  std::string title;  // "Goal"
  int num_tasks = 10;
  int horizon = 0;              // control steps after the settle steps
  int num_initial_states = 50;  // reproducible states per task; 0-19 report, 40-49 dev
  bool needs_libero = false;    // reads LIBERO's own files
  std::string robot = "panda";  // common/unit/robots.h
  bool states_go_on = false;    // the states of a task begin where those of the task before it end
};

// The four embedded suites, LIBERO's four, then those of other robots, in the order of the tables.
const std::vector<SuiteInfo>& AllSuites();
// Names of the suites of a robot.
std::vector<std::string> SuitesOf(const std::string& robot);
const SuiteInfo* FindSuite(const std::string& name);
// Control steps of an episode at most: unit.horizon, else the suite's; 0 where neither says.
int HorizonOf(const UnitConfig& unit);

}  // namespace robostress
