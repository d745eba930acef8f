#pragma once

#include <string>

#include "CLI/CLI.hpp"

namespace robostress {

// The command line of `app` as one line of JSON, for manual pages and completion (eval/manual):
//   {"name", "version", "summary", "examples",
//    "options": [{"names": ["--out"], "positional": "" or its name, "value": type text or "" for a
//                 flag, "default", "help", "group", "required", "many", "list"}],
//    "commands": [the same for each subcommand]}
std::string OptionTableText(const CLI::App& app);

}  // namespace robostress
