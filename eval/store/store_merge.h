#pragma once

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "eval/store/store_check.h"

namespace robostress {

struct MergeResult {
  int copied = 0;   // units
  int present = 0;  // were in the target before
  std::vector<StoreFinding> findings;
};

// Brings the finished units of several stores into one, `target`, which may be new or one of an
// earlier merge. Equal units are counted once. Nothing is written and FailedPrecondition lists
// everything when units are damaged, conflict, or ran on different weights or options. A unit is
// copied beside and renamed, so that a merge that is killed is completed by the same command.
absl::StatusOr<MergeResult> MergeStores(const std::vector<std::string>& stores,
                                        const std::string& target);

// One finding a line, as verify and merge print them.
std::string FindingsText(const std::vector<StoreFinding>& findings);

}  // namespace robostress
