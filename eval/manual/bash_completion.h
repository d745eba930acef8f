#pragma once

#include <map>
#include <string>
#include <vector>

#include "eval/manual/option_tables.h"

namespace robostress {

// What may stand behind an option, by the option's long name: {"--suite", {"tabletop_goal", ...}}.
using KnownValues = std::map<std::string, std::vector<std::string>>;

// A script that completes `program` by `tables`: its own and those of its commands ("robostress"
// and "robostress sweep", "robot_client" and "robot_client monitor").
std::string BashCompletion(const std::string& program, const std::vector<CommandTable>& tables,
                           const KnownValues& known);

}  // namespace robostress
