#pragma once

#include "sim_worker/expert_decision.h"
#include "sim_worker/panda_sim.h"
#include "sim_worker/suites/task_model.h"

namespace robostress {

// The scripted expert: a closed loop without memory. The phase (reach, close, carry, let go, turn
// ...) follows from the state alone, so that its commands are a function of what can be observed
// and a policy without memory can imitate them. Commands are proportional with a cap (headroom for
// correction) and a floor (stiction swallows small commands; see kMinCommand).
ExpertDecision DecideExpert(const TaskModel& model, const PandaSim& sim);

}  // namespace robostress
