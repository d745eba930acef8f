#pragma once

#include <string>

#include "absl/status/status.h"

namespace robostress {

// Writes RUN_DIR/environment.json: versions of this build, git revision of the sources when they
// are still there, processor, cores (the weights' hash is in each unit). Kept apart from the
// episode table, which must not depend on it.
absl::Status WriteEnvironment(const std::string& run_dir);

}  // namespace robostress
