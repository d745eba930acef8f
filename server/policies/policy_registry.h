#pragma once

#include <string>

namespace robostress {

// The file of "nano", or the path as given. ROBOSTRESS_WEIGHTS_DIR overrides where the weights that
// come with the source are.
std::string WeightsPath(const std::string& name_or_path);

// Whether the file is a nano policy's; false where it cannot be read.
bool IsNanoFile(const std::string& path);

}  // namespace robostress
