#include "eval/manual/option_tables.h"

#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "absl/strings/strip.h"
#include "common/atomic_file.h"
#include "common/status_macros.h"
#include "nlohmann/json.hpp"

namespace robostress {
namespace {

using nlohmann::json;

OptionEntry EntryOf(const json& option) {
  OptionEntry entry;
  entry.names = option.at("names").get<std::vector<std::string>>();
  entry.positional = option.at("positional");
  const std::string value = option.at("value");  // "INT:INT in [1 - 256]"
  const size_t colon = value.find(':');
  entry.value = value.substr(0, colon);
  if (colon != std::string::npos) entry.constraint = value.substr(colon + 1);
  entry.default_value = option.at("default");
  entry.help = option.at("help");
  entry.group = option.at("group");
  entry.required = option.at("required");
  entry.many = option.at("many");
  entry.list = option.at("list");
  return entry;
}

std::string Stripped(absl::string_view text) {
  return std::string(absl::StripAsciiWhitespace(text));
}

CommandTable TableOf(const json& app) {
  CommandTable table;
  table.name = app.at("name");
  table.version = app.at("version");
  // Some programs show their examples before the options, in the description.
  const std::string text = app.at("summary");
  const size_t examples = text.find("Examples");
  const std::string said = Stripped(text.substr(0, examples));
  if (examples != std::string::npos) table.examples = text.substr(examples);
  absl::StrAppend(&table.examples, app.at("examples").get<std::string>());
  table.description = absl::StrReplaceAll(said, {{"\n", " "}});
  const size_t end = table.description.find(". ");
  table.summary = std::string(absl::StripSuffix(table.description.substr(0, end), "."));
  for (const json& option : app.at("options")) table.options.push_back(EntryOf(option));
  for (const json& command : app.at("commands")) table.commands.push_back(TableOf(command));
  return table;
}

}  // namespace

std::string PageName(const CommandTable& table) {
  return absl::StrReplaceAll(table.name, {{" ", "-"}});
}

absl::StatusOr<CommandTable> ReadOptionTable(const std::string& file) {
  RS_ASSIGN_OR_RETURN(const std::string text, ReadFile(file));
  try {
    return TableOf(json::parse(text));
  } catch (const json::exception& error) {
    return absl::DataLossError(
        absl::StrCat(file, " is no option table (", error.what(),
                     "); it is what a program prints with --option-table alone"));
  }
}

}  // namespace robostress
