#include "common/libero/home.h"

#include <cstdlib>
#include <filesystem>

namespace robostress {
namespace {

namespace fs = std::filesystem;

std::string Variable(const char* name) {
  const char* value = std::getenv(name);
  return value == nullptr ? "" : value;
}

}  // namespace

std::string LiberoHome() {
  fs::path data = Variable("XDG_DATA_HOME");
  if (!data.is_absolute()) {  // as the XDG base directory specification says
    const std::string home = Variable("HOME");
    if (home.empty()) return "";
    data = fs::path(home) / ".local/share";
  }
  return (data / "robostress/libero").string();
}

std::string RememberedLibero() {
  const std::string home = LiberoHome();
  std::error_code ignored;
  const bool filled =
      !home.empty() && fs::is_symlink(fs::path(home) / "libero/libero/bddl_files", ignored);
  return filled ? home : "";
}

std::string LiberoRoot(const std::string& given, const char* variable) {
  if (!given.empty()) return given;
  const std::string set = Variable(variable);
  return set.empty() ? RememberedLibero() : set;
}

}  // namespace robostress
