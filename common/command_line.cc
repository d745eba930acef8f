#include "common/command_line.h"

#include <cerrno>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <optional>
#include <type_traits>
#include <utility>

#include "CLI/CLI.hpp"

namespace robostress::cli {
namespace {

Check Of(CLI::Validator validator) {
  std::string words = validator.get_description();
  return {[validator = std::move(validator)](const std::string& text) { return validator(text); },
          std::move(words)};
}

template <class T>
struct ValueOf {
  using Type = T;
};
template <class T>
struct ValueOf<std::vector<T>> : ValueOf<T> {};
template <class T>
struct ValueOf<std::optional<T>> : ValueOf<T> {};

// CLI11 takes the nearest number of 64 bits for one that does not fit into them.
template <class T>
std::string Overflow(const std::string& text) {
  errno = 0;
  if constexpr (std::is_signed_v<T>) {
    std::strtoll(text.c_str(), nullptr, 0);
  } else {
    std::strtoull(text.c_str(), nullptr, 0);
  }
  if (errno != ERANGE) return "";
  return text + " is out of range, must be " + std::to_string(std::numeric_limits<T>::min()) +
         " to " + std::to_string(std::numeric_limits<T>::max());
}

}  // namespace

Check Range(int low, int high) { return Of(CLI::Range(low, high)); }
Check Range(double low, double high) { return Of(CLI::Range(low, high)); }
Check IsMember(const std::vector<std::string>& known) { return Of(CLI::IsMember(known)); }
Check NonNegativeNumber() { return Of(CLI::NonNegativeNumber); }
Check PositiveNumber() { return Of(CLI::PositiveNumber); }
Check ExistingFile() { return Of(CLI::ExistingFile); }
Check ExistingDirectory() { return Of(CLI::ExistingDirectory); }

Option* Option::check(const Check& check) {
  option_->check(check.complaint, check.words);
  return this;
}
Option* Option::check(std::function<std::string(const std::string&)> complaint) {
  option_->check(std::move(complaint));
  return this;
}
Option* Option::capture_default_str() {
  option_->capture_default_str();
  return this;
}
Option* Option::default_str(const std::string& text) {
  option_->default_str(text);
  return this;
}
Option* Option::group(const std::string& name) {
  option_->group(name);
  return this;
}
Option* Option::delimiter(char delimiter) {
  option_->delimiter(delimiter);
  return this;
}
Option* Option::required() {
  option_->required();
  return this;
}
Option* Option::allow_extra_args(bool value) {
  option_->allow_extra_args(value);
  return this;
}
Option* Option::expected(int count) {
  option_->expected(count);
  return this;
}
Option* Option::expected(int least, int most) {
  option_->expected(least, most);
  return this;
}
Option* Option::type_name(const std::string& name) {
  option_->type_name(name);
  return this;
}
Option* Option::excludes(Option* other) {
  option_->excludes(other->option_);
  return this;
}
std::size_t Option::count() const { return option_->count(); }

App::App(const std::string& description, const std::string& name)
    : app_(std::make_shared<CLI::App>(description, name)) {}
App::App(CLI::App* app) : app_(app, [](CLI::App*) {}) {}
App::~App() = default;

Option* App::Keep(CLI::Option* option) { return &options_.emplace_back(option); }

template <class T>
Option* App::add_option(const std::string& name, T& value, const std::string& help) {
  CLI::Option* const option = app_->add_option(name, value, help);
  using Value = typename ValueOf<T>::Type;
  if constexpr (std::is_same_v<Value, int64_t> || std::is_same_v<Value, uint64_t>)
    option->check(Overflow<Value>);
  return Keep(option);
}
template <class T>
Option* App::add_flag(const std::string& name, T& value, const std::string& help) {
  return Keep(app_->add_flag(name, value, help));
}

#define ROBOSTRESS_OPTION(...) \
  template Option* App::add_option(const std::string&, __VA_ARGS__&, const std::string&)
#define ROBOSTRESS_OPTIONS(T)        \
  ROBOSTRESS_OPTION(T);              \
  ROBOSTRESS_OPTION(std::vector<T>); \
  ROBOSTRESS_OPTION(std::optional<T>)
ROBOSTRESS_OPTIONS(std::string);
ROBOSTRESS_OPTIONS(int);
ROBOSTRESS_OPTIONS(int64_t);
ROBOSTRESS_OPTIONS(uint64_t);
ROBOSTRESS_OPTIONS(double);
ROBOSTRESS_OPTION(float);
ROBOSTRESS_OPTION(unsigned);
ROBOSTRESS_OPTION(bool);
template Option* App::add_flag(const std::string&, bool&, const std::string&);

Option* App::add_option_function(const std::string& name,
                                 const std::function<void(const std::string&)>& take,
                                 const std::string& help) {
  return Keep(app_->add_option_function(name, take, help));
}

void App::add_last_flag(const std::string& name, const std::function<void()>& act,
                        const std::string& help) {
  app_->add_flag_callback(
      name,
      [act] {
        act();
        throw CLI::Success();
      },
      help);
}

App* App::add_subcommand(const std::string& name, const std::string& description) {
  commands_.emplace_back(new App(app_->add_subcommand(name, description)));
  return commands_.back().get();
}

Option* App::get_option(const std::string& name) { return Keep(app_->get_option(name)); }

App* App::footer(const std::string& text) {
  app_->footer(text);
  return this;
}
App* App::require_subcommand(int count) {
  app_->require_subcommand(count);
  return this;
}
App* App::require_subcommand(int least, int most) {
  app_->require_subcommand(least, most);
  return this;
}
App* App::fallthrough() {
  app_->fallthrough();
  return this;
}
App* App::prefix_command() {
  app_->prefix_command();
  return this;
}
App* App::allow_extras() {
  app_->allow_extras();
  return this;
}
App* App::set_help_flag() {
  app_->set_help_flag();
  return this;
}
App* App::set_version_flag(const std::string& name, const std::string& text,
                           const std::string& help) {
  app_->set_version_flag(name, text, help);
  return this;
}

std::size_t App::count(const std::string& name) const { return app_->count(name); }
bool App::got_subcommand(const std::string& name) const { return app_->got_subcommand(name); }
bool App::parsed() const { return app_->parsed(); }
const std::string& App::name() const { return app_->get_name(); }

bool App::ParseQuietly(int argc, char** argv) {
  try {
    app_->parse(argc, argv);
  } catch (const CLI::ParseError&) {
    return false;
  }
  return true;
}

}  // namespace robostress::cli
