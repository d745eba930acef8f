#pragma once

#include <filesystem>
#include <fstream>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "tests/run_program.h"

namespace robostress {

// The libraries that LeRobot reads with, from PyPI, in a virtual environment of the build folder:
// later runs find it there. What failed, or empty.
inline const std::string& ReaderFailure() {
  static const std::string failure = []() -> std::string {
    const std::string venv = LEROBOT_VENV, done = venv + "/DONE";
    if (std::filesystem::exists(done)) return "";
    for (const std::string& command :
         {"python3 -m venv --clear " + venv,
          venv + "/bin/python -m pip install --quiet --disable-pip-version-check "
                 "--only-binary=:all: --timeout 15 --retries 1 -r " LEROBOT_TESTS
                 "/read_requirements.txt"}) {
      const auto [output, code] = RunProgram(command, "");
      if (code != 0) return absl::StrCat(command, " failed: ", output);
    }
    std::ofstream(done) << "installed\n";
    return "";
  }();
  return failure;
}

// Output and exit code of read_dataset.py.
inline std::pair<std::string, int> ReadBack(const std::string& arguments) {
  return RunProgram(
      "HF_HUB_OFFLINE=1 HF_DATASETS_OFFLINE=1 HF_DATASETS_DISABLE_PROGRESS_BARS=1 "
      "nice -n 19 " LEROBOT_VENV "/bin/python " LEROBOT_TESTS "/read_dataset.py",
      arguments);
}

}  // namespace robostress
