#pragma once

#include <string>

#include "common/command_line.h"

namespace robostress {

// The command line of `app` as one line of JSON, for manual pages and completion (eval/manual):
//   {"name", "version", "summary", "examples",
//    "options": [{"names": ["--out"], "positional": "" or its name, "value": type text or "" for a
//                 flag, "default", "help", "group", "required", "many", "list"}],
//    "commands": [the same for each subcommand]}
std::string OptionTableText(cli::App& app);

}  // namespace robostress
