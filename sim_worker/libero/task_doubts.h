#pragma once

#include <string>
#include <vector>

#include "sim_worker/libero/bddl.h"

namespace robostress::libero {

// What LIBERO takes without a word in a task's :init though it hardly is meant: predicates and
// names that it does not know and skips, fixtures that no line places and that so stand at the
// world's origin. A sentence each, with file and line.
std::vector<std::string> DoubtsOf(const BddlProblem& problem);

}  // namespace robostress::libero
