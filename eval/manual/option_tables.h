#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress {

// One option or positional argument, as common/option_table prints it.
struct OptionEntry {
  std::vector<std::string> names;  // "-h", "--help"; empty: positional only
  std::string positional;          // empty: none
  std::string value;               // what it takes: "TEXT"; empty: a flag
  std::string constraint;          // of the value: "INT in [1 - 256]", "{a,b}"; empty: none
  std::string default_value, help, group;
  bool required = false, many = false, list = false;  // list: values with commas between them
};

// A command line: of a program, of a program's command, or of that one's command.
struct CommandTable {
  std::string name;  // "robostress sweep", "robot_client monitor"; of a subcommand its last word
  std::string version, summary, description, examples;
  std::vector<OptionEntry> options;
  std::vector<CommandTable> commands;
};

// "robostress-sweep": the name of its page and of its completion.
std::string PageName(const CommandTable& table);

absl::StatusOr<CommandTable> ReadOptionTable(const std::string& file);

}  // namespace robostress
