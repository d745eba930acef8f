#pragma once

#include <filesystem>
#include <fstream>
#include <string>

#include "absl/strings/str_cat.h"
#include "tests/run_program.h"

namespace robostress {

// The libraries that others read and write recordings with (PyPI's mcap, rosbags, pyarrow, h5py),
// in a virtual environment of the build folder: later runs find it there. What failed, or empty.
inline const std::string& RecordingPeersFailure() {
  static const std::string failure = []() -> std::string {
    const std::string venv = RECORDINGS_VENV, done = venv + "/DONE";
    if (std::filesystem::exists(done)) return "";
    for (const std::string& command :
         {"python3 -m venv --clear " + venv,
          venv + "/bin/python -m pip install --quiet --disable-pip-version-check "
                 "--only-binary=:all: --timeout 15 --retries 1 -r " RECORDINGS_TESTS
                 "/peers_requirements.txt"}) {
      const auto [output, code] = RunProgram(command, "");
      if (code != 0) return absl::StrCat(command, " failed: ", output);
    }
    std::ofstream(done) << "installed\n";
    return "";
  }();
  return failure;
}

}  // namespace robostress
