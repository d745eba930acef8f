#pragma once

#include <cstdlib>
#include <iostream>
#include <string>

#include "absl/status/status.h"
#include "absl/strings/match.h"

namespace robostress {

// Ends a fuzzer's run as a finding unless `condition` holds.
inline void FuzzCheck(bool condition, const std::string& what) {
  if (condition) return;
  std::cerr << "finding: " << what << "\n";
  std::abort();
}

// What every reader promises: it refuses with a message that names the file.
inline void CheckRefusal(const absl::Status& status, const std::string& file) {
  FuzzCheck(absl::StrContains(status.message(), file),
            "the message does not name the file: " + status.ToString());
}

}  // namespace robostress
