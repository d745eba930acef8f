#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "eval/plan/plan.h"

namespace robostress {

// Dials every server of `--policy-url` and hangs up: what no unit could use is said once, before
// any starts. One that refuses us, or says that it serves something else than is asked, is an
// error: RemotePolicy::Connect's. One that is not there is warned of as long as another is, because
// it may come; and so are two that do not say the same of their model.
absl::Status DialPolicyUrls(const std::vector<std::string>& urls, const SweepGrid& grid);

}  // namespace robostress
