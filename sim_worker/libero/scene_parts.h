#pragma once

#include "absl/status/statusor.h"
#include "common/libero/bddl.h"
#include "sim_worker/libero/catalog.h"
#include "sim_worker/libero/mjcf.h"

namespace robostress::libero {

// Is the region a zone of the arena's table or floor?
bool OnWorkspace(const ProblemClass& problem, const BddlRegion& region);

// The arena: LIBERO's scene file with its table placed, textures chosen, cameras set and regions
// added.
absl::StatusOr<MjcfFile> MakeArena(const LiberoPaths& paths, const BddlProblem& bddl,
                                   const ProblemClass& problem);

// robosuite's Panda on its mount, with its gripper in its hand.
absl::StatusOr<MjcfFile> MakeRobot(const LiberoPaths& paths, const ProblemClass& problem);

}  // namespace robostress::libero
