#pragma once

#include <string>
#include <vector>

namespace robostress {

// What a sweep must know of a suite before a simulator starts.
struct SuiteInfo {
  std::string name;      // "tabletop_goal", "libero_goal"
  std::string title;     // "Goal"
  int num_tasks = 10;
  int horizon = 0;       // control steps after the settle steps
  int num_initial_states = 50;  // reproducible states per task; 0-19 report, 40-49 dev
  bool needs_libero = false;    // reads LIBERO's own files
};

// The four embedded suites, then LIBERO's four, in the order of the tables.
const std::vector<SuiteInfo>& AllSuites();
const SuiteInfo* FindSuite(const std::string& name);

}  // namespace robostress
