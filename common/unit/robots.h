#pragma once

#include <string>
#include <utility>
#include <vector>

#include "absl/status/statusor.h"
#include "common/robot_description.h"

namespace robostress {

// What a sweep must know of a robot: whose suites it plays and who runs its units. Its suites are
// those of common/suites.h that name it.
struct RobotInfo {
  std::string name;  // "panda", "piper"
  RobotDescription description;
  std::string worker;               // robostress-WORKER --unit FILE --out DIR [--server HOST:PORT]
  std::string policy;               // what a grid that names none evaluates
  std::vector<std::string> suites;  // what a grid that names none plays
  // Arms with a name and a title, which are its scenarios and have one level; empty: the scenarios
  // are those of `robostress scenarios`.
  std::vector<std::pair<std::string, std::string>> arms;
  std::vector<std::string> methods;   // that it can run, in the order of the tables
  std::vector<std::string> policies;  // embedded ones that move it
  // An episode is the same whatever was played before it: a unit may be run in parts, and goes on
  // where it was stopped.
  bool episodes_stand_alone = true;
};

const std::vector<RobotInfo>& AllRobots();
// NotFound names those that there are.
absl::StatusOr<RobotInfo> FindRobot(const std::string& name);
// Scenarios of the robot by name, in the order of the tables.
std::vector<std::string> ScenariosOf(const RobotInfo& robot);
// Title of an arm of some robot; empty for a name that is none. Arms have no levels.
std::string ArmTitle(const std::string& scenario);

}  // namespace robostress
