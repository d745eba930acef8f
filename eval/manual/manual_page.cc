#include "eval/manual/manual_page.h"

#include <algorithm>
#include <cstdint>
#include <utility>

#include "absl/strings/ascii.h"
#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_join.h"
#include "absl/strings/str_split.h"

namespace robostress {
namespace {

// Code point of the UTF-8 sequence that begins at text[*at]; moves *at behind it.
uint32_t CodePoint(const std::string& text, size_t* at) {
  const unsigned char lead = text[(*at)++];
  const int more = lead >= 0xf0 ? 3 : lead >= 0xe0 ? 2 : 1;
  uint32_t code = lead & (0x3f >> more);
  for (int i = 0; i < more && *at < text.size(); ++i) code = code << 6 | (text[(*at)++] & 0x3f);
  return code;
}

// Text that roff shows as it is.
std::string Roff(const std::string& text) {
  std::string out;
  for (size_t at = 0; at < text.size();) {
    const char c = text[at];
    if (static_cast<unsigned char>(c) >= 0x80) {
      absl::StrAppendFormat(&out, "\\[u%04X]", CodePoint(text, &at));
      continue;
    }
    ++at;
    const bool begins_line = out.empty() || out.back() == '\n';
    if (begins_line && (c == '.' || c == '\'')) out += "\\&";
    switch (c) {
      case '\\':
        out += "\\e";
        break;
      case '-':
        out += "\\-";
        break;
      case '\'':
        out += "\\(aq";
        break;
      case '^':
        out += "\\(ha";
        break;
      case '~':
        out += "\\(ti";
        break;
      case '`':
        out += "\\(ga";
        break;
      default:
        out += c;
    }
  }
  return out;
}

// "a,b,c" may be broken behind its commas.
std::string Breakable(const std::string& roff) {
  return absl::StrJoin(absl::StrSplit(roff, ','), ",\\:");
}

std::string Bold(const std::string& text) { return absl::StrCat("\\fB", Roff(text), "\\fR"); }
std::string Italic(const std::string& text) { return absl::StrCat("\\fI", Roff(text), "\\fR"); }

// "--out TEXT", the line above an option's help.
std::string Head(const OptionEntry& option) {
  std::string head =
      option.names.empty()
          ? Italic(option.positional)
          : absl::StrJoin(option.names, ", ",
                          [](std::string* out, const auto& name) { out->append(Bold(name)); });
  if (!option.names.empty() && !option.value.empty()) {
    absl::StrAppend(&head, " ", Italic(option.value), option.many && !option.list ? " ..." : "");
  }
  return head;
}

std::string Help(const OptionEntry& option) {
  std::string help = option.help;
  const size_t word =
      help.find(' ');  // a list of values begins as it is: "base, ours", "panda (default)"
  const bool values =
      word != std::string::npos && word > 0 && (help[word - 1] == ',' || help[word + 1] == '(');
  if (!help.empty() && !values) help[0] = absl::ascii_toupper(help[0]);
  if (!help.empty() && !absl::EndsWith(help, ".")) help += '.';
  if (!option.constraint.empty()) absl::StrAppend(&help, " Value: ", option.constraint, ".");
  if (option.list) help += " Several with commas between them.";
  if (option.required) help += " Required.";
  if (!option.default_value.empty() && option.default_value != "[]" &&
      !absl::StrContains(option.help, "default"))
    absl::StrAppend(&help, " Default: ", option.default_value, ".");
  return Breakable(Roff(help));
}

// Those of no group first, then each group under its title.
std::string Options(const std::vector<OptionEntry>& options) {
  std::vector<std::pair<std::string, std::string>> groups = {{"Options", ""}};
  for (const OptionEntry& option : options) {
    const std::string name = option.group == "Positionals" ? "Options" : option.group;
    auto group = std::find_if(groups.begin(), groups.end(),
                              [&](const auto& present) { return present.first == name; });
    if (group == groups.end()) group = groups.insert(group, {name, ""});
    absl::StrAppend(&group->second, ".TP\n", Head(option), "\n", Help(option), "\n");
  }
  std::string text = groups[0].second;
  for (size_t i = 1; i < groups.size(); ++i)
    absl::StrAppend(&text, ".SS ", Roff(groups[i].first), "\n", groups[i].second);
  return text;
}

std::string Commands(const std::vector<CommandTable>& commands) {
  std::string text;
  for (const CommandTable& command : commands) {
    if (command.options.empty() && command.commands.empty()) {  // has a page of its own
      absl::StrAppend(&text, ".TP\n", Bold(command.name), "\n", Roff(command.description), "\n");
      continue;
    }
    absl::StrAppend(&text, ".SS ", Roff(command.name), "\n", Roff(command.description), "\n",
                    Options(command.options), Commands(command.commands));
  }
  return text;
}

std::string Synopsis(const CommandTable& table) {
  std::string text = Bold(table.name);
  if (!table.commands.empty()) absl::StrAppend(&text, " ", Italic("COMMAND"));
  absl::StrAppend(&text, " [", Italic("OPTION"), "]...");
  for (const OptionEntry& option : table.options) {
    if (option.positional.empty()) continue;
    const std::string name = Italic(option.positional) + (option.many ? "..." : "");
    absl::StrAppend(&text,
                    option.required ? absl::StrCat(" ", name) : absl::StrCat(" [", name, "]"));
  }
  return text;
}

// Examples and what a program says below them, lines as they are.
std::string Examples(const std::string& examples) {
  std::string text(absl::StripAsciiWhitespace(examples));
  for (const char* title : {"Examples:", "Examples"}) {
    if (absl::StartsWith(text, title)) {
      text = text.substr(std::string(title).size());
      break;
    }
  }
  while (absl::StartsWith(text, "\n")) text.erase(0, 1);
  return absl::StrCat(".nf\n", Roff(text), "\n.fi\n");
}

}  // namespace

std::string ManualPage(const CommandTable& table, const std::vector<std::string>& others) {
  const std::string page = PageName(table);
  std::string text = absl::StrCat(
      ".\\\" Made from the program's option table by write_manual; changes here are lost.\n.TH ",
      Roff(absl::AsciiStrToUpper(page)), " 1 \"\" \"RoboStress ", table.version,
      "\" \"User Commands\"\n.nh\n.ad l\n.SH NAME\n", Roff(page), " \\- ", Roff(table.summary),
      "\n.SH SYNOPSIS\n", Synopsis(table), "\n.SH DESCRIPTION\n", Roff(table.description),
      "\n.SH OPTIONS\n", Options(table.options));
  if (!table.commands.empty()) absl::StrAppend(&text, ".SH COMMANDS\n", Commands(table.commands));
  if (!table.examples.empty()) absl::StrAppend(&text, ".SH EXAMPLES\n", Examples(table.examples));
  std::vector<std::string> see;
  for (const std::string& other : others) {
    if (other != page) see.push_back(absl::StrCat("\\fB", Roff(other), "\\fR(1)"));
  }
  if (!see.empty()) absl::StrAppend(&text, ".SH SEE ALSO\n", absl::StrJoin(see, ",\n"), "\n");
  return text;
}

}  // namespace robostress
