#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "tests/run_program.h"

namespace robostress {

// A Python with openpi's own packages from PyPI, made once per build folder.
struct OpenpiVenv {
  std::string python;
  std::string failure;  // empty: it is there; else why a test must be skipped

  static const OpenpiVenv& Get() {
    static const OpenpiVenv& venv =
        *new OpenpiVenv(Make(OPENPI_CLIENT_VENV, OPENPI_CLIENT_REQUIREMENTS, "openpi-client"));
    return venv;
  }
  // The same with other packages, for `package`.
  static OpenpiVenv Make(const std::string& folder, const std::string& requirements,
                         const std::string& package) {
    const std::string done = folder + "/DONE";
    OpenpiVenv venv{folder + "/bin/python", ""};
    if (std::filesystem::exists(done)) return venv;
    const auto attempt = [&](const std::string& program, const std::string& arguments) {
      if (!venv.failure.empty()) return;
      const auto [output, code] = RunProgram(program, arguments);
      if (code == 0) return;
      venv.failure =
          absl::StrCat("needs python3-venv and PyPI for ", package, ": ", program, ": ", output);
    };
    attempt("python3 -m venv --clear", folder);
    attempt(venv.python,
            absl::StrCat("-m pip install --quiet --disable-pip-version-check --no-deps "
                         "--only-binary=:all: --timeout 15 --retries 1 -r ",
                         requirements));
    if (venv.failure.empty()) std::ofstream(done) << "installed\n";
    return venv;
  }
};

}  // namespace robostress
