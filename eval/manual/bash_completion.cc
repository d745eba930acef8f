#include "eval/manual/bash_completion.h"

#include <algorithm>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"
#include "absl/strings/strip.h"

namespace robostress {
namespace {

// Words of each command line, and what stands behind each option that takes a value: its kind
// ("one", or "list" with commas) and the known values; none: names of files.
constexpr char kFunction[] = R"(
_robostress_complete() {
  local word=${COMP_WORDS[COMP_CWORD]} before=${COMP_WORDS[COMP_CWORD - 1]} table=${COMP_WORDS[0]##*/}
  local i candidates known head='' hidden=''
  for ((i = 1; i < COMP_CWORD; ++i)); do
    if [[ ${COMP_WORDS[i]} == [a-z]* && -n ${_robostress_words[$table-${COMP_WORDS[i]}]-} ]]; then
      table=$table-${COMP_WORDS[i]}
    fi
  done
  candidates=${_robostress_words[$table]-}
  known=${_robostress_values["$table $before"]-}
  if [[ -n $known ]]; then
    candidates=${known#* }
    if [[ $known == list* && $word == *,* ]]; then
      head=${word%,*},
      word=${word##*,}
    fi
  fi
  if [[ $word != -* ]]; then hidden='-*'; fi # commands and values, else names of files
  # shellcheck disable=SC2207  # no candidate holds a space
  COMPREPLY=($(compgen -P "$head" -X "$hidden" -W "$candidates" -- "$word"))
}
)";

// {a,b,c}, as CLI11 shows a set that a value must be of.
std::vector<std::string> ValuesIn(const std::string& constraint) {
  if (!absl::StartsWith(constraint, "{") || !absl::EndsWith(constraint, "}")) return {};
  return absl::StrSplit(constraint.substr(1, constraint.size() - 2), ',');
}

std::vector<std::string> ValuesOf(const OptionEntry& option, const KnownValues& known) {
  for (const std::string& name : option.names) {
    if (const auto found = known.find(name); found != known.end()) return found->second;
  }
  return ValuesIn(option.constraint);
}

void AddTable(const std::string& page, const CommandTable& table, const KnownValues& known,
              std::string* words_text, std::string* values_text) {
  std::vector<std::string> words;
  for (const CommandTable& command : table.commands) {
    words.push_back(command.name);
    // The front door's commands are programs with tables of their own.
    if (!command.options.empty())
      AddTable(absl::StrCat(page, "-", command.name), command, known, words_text, values_text);
  }
  for (const OptionEntry& option : table.options) {
    for (const std::string& name : option.names) {
      if (absl::StartsWith(name, "--")) words.push_back(name);
      if (option.value.empty()) continue;
      absl::StrAppend(values_text, "_robostress_values['", page, " ", name, "']='",
                      option.list ? "list " : "one ", absl::StrJoin(ValuesOf(option, known), " "),
                      "'\n");
    }
    if (option.names.empty()) {
      for (std::string& value : ValuesIn(option.constraint)) words.push_back(std::move(value));
    }
  }
  absl::StrAppend(words_text, "_robostress_words['", page, "']='", absl::StrJoin(words, " "),
                  "'\n");
}

}  // namespace

std::string BashCompletion(const std::string& program, const std::vector<CommandTable>& tables,
                           const KnownValues& known) {
  std::string words, values;
  for (const CommandTable& table : tables) {
    CommandTable whole = table;
    if (table.name == program) {  // commands that are tables of their own
      for (const CommandTable& other : tables) {
        if (!absl::StartsWith(other.name, program + " ")) continue;
        CommandTable command;
        command.name = std::string(absl::StripPrefix(other.name, program + " "));
        const bool listed =
            std::any_of(whole.commands.begin(), whole.commands.end(),
                        [&](const CommandTable& present) { return present.name == command.name; });
        if (!listed) whole.commands.push_back(command);
      }
    }
    AddTable(PageName(table), whole, known, &words, &values);
  }
  return absl::StrCat("# Completion of ", program,
                      " in bash, made from option tables by write_manual.\n"
                      "# shellcheck shell=bash\n"
                      "declare -gA _robostress_words _robostress_values\n",
                      words, values, kFunction, "\ncomplete -o default -F _robostress_complete ",
                      program, "\n");
}

}  // namespace robostress
