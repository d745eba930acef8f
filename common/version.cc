#include "common/version.h"

namespace robostress {

const char* BuildVersion() { return ROBOSTRESS_VERSION; }
const char* BuildRevision() { return ROBOSTRESS_REVISION; }
std::string VersionText() { return std::string(BuildVersion()) + " (" + BuildRevision() + ")"; }

}  // namespace robostress
