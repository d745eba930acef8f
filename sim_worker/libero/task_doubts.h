#pragma once

#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/libero/bddl.h"
#include "sim_worker/libero/catalog.h"

namespace robostress::libero {

// What LIBERO takes without a word though it hardly is meant: predicates and names of :init that it
// does not know and skips, an instruction that is not there. A sentence each, with file and line.
std::vector<std::string> DoubtsOf(const BddlProblem& problem);

// InvalidArgument, with file and line, for a fixture that no line of :init places, so that LIBERO
// leaves it at the world's origin, or that two lines place. No published task has one.
absl::Status CheckFixturesPlaced(const BddlProblem& problem, const ProblemClass& problem_class);

}  // namespace robostress::libero
