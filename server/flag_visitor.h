#pragma once

#include <algorithm>
#include <string>
#include <type_traits>

#include "common/command_line.h"

namespace robostress {

// Makes one flag per field of an options struct (common/config.h): key a_b becomes --a-b, with the
// field's present value as default; a bool also gets --no-a-b.
class FlagVisitor {
 public:
  explicit FlagVisitor(cli::App* app) : app_(app) {}

  template <class T>
  void Field(const char* key, T& value, const char* doc) {
    const std::string name = FlagOf(key);
    if constexpr (std::is_same_v<T, bool>) {
      app_->add_flag("--" + name + ",!--no-" + name, value, doc)->capture_default_str();
    } else {
      cli::Option* const option = app_->add_option("--" + name, value, doc);
      if constexpr (requires { value.empty(); }) {
        if (value.empty()) return;  // "=[]" would be its default in the help
      }
      option->capture_default_str();
    }
  }

  static std::string FlagOf(std::string key) {
    std::replace(key.begin(), key.end(), '_', '-');
    return key;
  }

 private:
  cli::App* const app_;
};

}  // namespace robostress
