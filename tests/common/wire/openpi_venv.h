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
    static const OpenpiVenv& venv = *new OpenpiVenv(Make());
    return venv;
  }

 private:
  static OpenpiVenv Make() {
    const std::string folder = OPENPI_CLIENT_VENV, done = folder + "/DONE";
    OpenpiVenv venv{folder + "/bin/python", ""};
    if (std::filesystem::exists(done)) return venv;
    const auto attempt = [&venv](const std::string& program, const std::string& arguments) {
      if (!venv.failure.empty()) return;
      const auto [output, code] = RunProgram(program, arguments);
      if (code == 0) return;
      venv.failure =
          absl::StrCat("needs python3-venv and PyPI for openpi-client: ", program, ": ", output);
    };
    attempt("python3 -m venv --clear", folder);
    attempt(venv.python,
            "-m pip install --quiet --disable-pip-version-check --no-deps --only-binary=:all: "
            "--timeout 15 --retries 1 -r " OPENPI_CLIENT_REQUIREMENTS);
    if (venv.failure.empty()) std::ofstream(done) << "installed\n";
    return venv;
  }
};

}  // namespace robostress
