#pragma once

#include <sys/wait.h>

#include <cstdlib>
#include <string>
#include <utility>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"

namespace robostress {

// Runs a program of the build, with stand-ins for worker and server; its exit code, and the output
// of both streams.
inline std::pair<int, std::string> RunGrid(const std::string& folder, const std::string& program,
                                           const std::string& arguments,
                                           const std::string& environment = "") {
  const std::string output = folder + "/output.txt";
  const int status =
      std::system(absl::StrCat("ROBOSTRESS_BIN='", FAKE_PROGRAMS, "' ", environment, " '", BIN_DIR,
                               "/robostress-", program, "' ", arguments, " > '", output, "' 2>&1")
                      .c_str());
  return {WIFEXITED(status) ? WEXITSTATUS(status) : -1, ReadFile(output).value_or("")};
}

// Two tasks of one suite, Clean and Heavy Payload, base and ours: four units of six episodes.
inline std::string SmallGrid() {
  return "--suites tabletop_goal --tasks 2 --episodes 3 --scenarios clean,heavy_payload --methods "
         "base,ours ";
}

}  // namespace robostress
