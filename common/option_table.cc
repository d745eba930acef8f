#include "common/option_table.h"

#include <vector>

#include "CLI/CLI.hpp"
#include "common/version.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;

json OptionJson(const CLI::Option& option) {
  std::vector<std::string> names;
  for (const std::string& name : option.get_snames()) names.push_back("-" + name);
  for (const std::string& name : option.get_lnames()) names.push_back("--" + name);
  const bool takes_value = option.get_type_size() != 0;
  return {{"names", names},
          {"positional", option.get_positional() ? option.get_name(/*positional=*/true) : ""},
          {"value", takes_value ? option.get_type_name() : ""},
          {"default", takes_value ? option.get_default_str() : ""},
          {"help", option.get_description()},
          {"group", option.get_group()},
          {"required", option.get_required()},
          {"many", option.get_expected_max() > 1},
          {"list", option.get_delimiter() != '\0'}};
}

json AppJson(const CLI::App& app) {
  json options = json::array();
  for (const CLI::Option* option : app.get_options()) {
    if (!option->get_group().empty()) options.push_back(OptionJson(*option));  // empty: hidden
  }
  json commands = json::array();
  for (const CLI::App* command : app.get_subcommands([](const CLI::App*) { return true; }))
    commands.push_back(AppJson(*command));
  return {{"name", app.get_name()},
          {"version", BuildVersion()},
          {"summary", app.get_description()},
          {"examples", app.get_footer()},
          {"options", options},
          {"commands", commands}};
}

}  // namespace

std::string OptionTableText(cli::App& app) {
  return AppJson(app.underlying()).dump(-1, ' ', false, json::error_handler_t::replace);
}

}  // namespace robostress
