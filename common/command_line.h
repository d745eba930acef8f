#pragma once

#include <cstddef>
#include <deque>
#include <functional>
#include <memory>
#include <string>
#include <vector>

namespace CLI {  // NOLINT(readability-identifier-naming): the library's name
class App;
class Option;
}  // namespace CLI

// A program's command line: CLI11 with its names, whose headers stay in command_line.cc. A unit
// that includes them compiles for seven seconds more.
namespace robostress::cli {

// What a value must be: the complaint about a text, empty where it is right. `words` stand in the
// help behind the option's type.
struct Check {
  std::function<std::string(const std::string&)> complaint;
  std::string words;
};
// Both ends included.
Check Range(int low, int high);
Check Range(double low, double high);
Check IsMember(const std::vector<std::string>& known);
Check NonNegativeNumber();
Check PositiveNumber();
Check ExistingFile();
Check ExistingDirectory();

// Of one option; its App owns it. Each returns itself.
class Option {
 public:
  explicit Option(CLI::Option* option) : option_(option) {}

  Option* check(const Check& check);
  Option* check(std::function<std::string(const std::string&)> complaint);
  Option* capture_default_str();  // the value's present text is the help's default
  Option* default_str(const std::string& text);
  Option* group(const std::string& name);
  Option* delimiter(char delimiter);
  Option* required();
  Option* allow_extra_args(bool value);  // whether one mention takes several values
  Option* expected(int count);
  Option* expected(int least, int most);
  Option* type_name(const std::string& name);
  Option* excludes(Option* other);

  std::size_t count() const;  // how often it was given

 private:
  CLI::Option* const option_;
};

// A program or a subcommand of one. Values outlive the parsing (common/run_main.h).
class App {
 public:
  explicit App(const std::string& description = "", const std::string& name = "");
  ~App();
  App(const App&) = delete;
  App& operator=(const App&) = delete;

  // T: std::string, bool, the integers of 32 and 64 bits, float, double, and vectors and optionals
  // of these (command_line.cc lists them).
  template <class T>
  Option* add_option(const std::string& name, T& value, const std::string& help = "");
  Option* add_option_function(const std::string& name,
                              const std::function<void(const std::string&)>& take,
                              const std::string& help);
  template <class T>
  Option* add_flag(const std::string& name, T& value, const std::string& help = "");
  // Where it is given the program does `act` and ends, exit code 0.
  void add_last_flag(const std::string& name, const std::function<void()>& act,
                     const std::string& help);
  App* add_subcommand(const std::string& name, const std::string& description);
  Option* get_option(const std::string& name);

  App* footer(const std::string& text);
  App* require_subcommand(int count);
  App* require_subcommand(int least, int most);
  App* fallthrough();     // a subcommand's unknown options are looked for here
  App* prefix_command();  // whatever follows is left alone
  App* allow_extras();
  App* set_help_flag();  // there is none
  App* set_version_flag(const std::string& name, const std::string& text, const std::string& help);

  std::size_t count(const std::string& name) const;
  bool got_subcommand(const std::string& name) const;
  bool parsed() const;
  const std::string& name() const;
  // Parses and says nothing: false where something is wrong or help was asked for.
  bool ParseQuietly(int argc, char** argv);

  CLI::App& underlying() { return *app_; }

 private:
  explicit App(CLI::App* app);
  Option* Keep(CLI::Option* option);

  std::shared_ptr<CLI::App> app_;  // a subcommand's belongs to its parent's
  std::deque<Option> options_;
  std::deque<std::unique_ptr<App>> commands_;
};

}  // namespace robostress::cli
