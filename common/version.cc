#include "common/version.h"

#include "absl/strings/str_cat.h"

namespace robostress {

const char* BuildVersion() { return ROBOSTRESS_VERSION; }
const char* BuildRevision() { return ROBOSTRESS_REVISION; }
std::string VersionText() { return absl::StrCat(BuildVersion(), " (", BuildRevision(), ")"); }

}  // namespace robostress
