#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "eval/plan/plan.h"

namespace robostress {

// Dials the servers of `--policy-url` until one greets as it should, and hangs up: what no unit
// could use is said once, before any starts. Nobody there, another wire, a token that is missing, a
// model of other sizes: RemotePolicy::Connect's error of the first.
absl::Status DialPolicyUrls(const std::vector<std::string>& urls, const SweepGrid& grid);

}  // namespace robostress
