#pragma once

#include <string>

namespace robostress {

// Where `robostress libero setup` links LIBERO's and robosuite's files, laid out as their checkouts
// are: $XDG_DATA_HOME/robostress/libero, else ~/.local/share/robostress/libero; empty without
// either variable.
std::string LiberoHome();
// LiberoHome() if setup has filled it, else empty.
std::string RememberedLibero();
// The root that is looked in for LIBERO's or robosuite's files: `given`, else the environment
// variable (LIBERO_ROOT, ROBOSUITE_ROOT), else RememberedLibero().
std::string LiberoRoot(const std::string& given, const char* variable);

}  // namespace robostress
