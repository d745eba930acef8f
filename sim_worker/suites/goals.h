#pragma once

#include <mujoco/mujoco.h>

#include "sim_worker/panda_sim.h"
#include "sim_worker/suites/task_model.h"

namespace robostress {

// Whether a goal holds now. kPlace: the object's origin lies over the region, at rest on its
// surface, upright and out of the gripper. kOpen, kTurnOn: the joint is past Handle::done. kPush:
// the object's centre lies in the region.
bool GoalHolds(const TaskModel& model, const PandaSim& sim, const Goal& goal);

// All goals of the task hold at once.
bool TaskSucceeds(const TaskModel& model, const PandaSim& sim);

// Index of the first goal that does not hold; the number of goals if all do.
int FirstOpenGoal(const TaskModel& model, const PandaSim& sim);

}  // namespace robostress
