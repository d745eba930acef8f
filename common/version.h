#pragma once

#include <string>

namespace robostress {

// The version of this program (CMake's PROJECT_VERSION) and the revision of its sources when it was
// configured ("unknown" outside a repository). What a program says of itself comes from here.
const char* BuildVersion();
const char* BuildRevision();
// "0.2.0 (3047618a1b2c)".
std::string VersionText();

}  // namespace robostress
