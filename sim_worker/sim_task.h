#pragma once

#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/robot.h"
#include "common/unit_config.h"
#include "sim_worker/expert_decision.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

// The views that every task has.
inline constexpr char kAgentView[] = "agentview";
inline constexpr char kWristView[] = "robot0_eye_in_hand";

// Initial states from here on are drawn for training; below are the reproducible ones.
inline constexpr int kFirstTrainingDraw = 1000;

// One task of a suite in simulation.
class SimTask : public Robot {
 public:
  virtual const std::string& name() const = 0;
  virtual const std::string& instruction() const = 0;
  virtual PandaSim& sim() = 0;
  // What the scene is compiled from, with everything where the last reset put it.
  virtual std::string mjcf() const = 0;
  // LIBERO's class of the scene, "libero_tabletop_manipulation"; empty: none of LIBERO's.
  virtual std::string problem() const { return ""; }
  // The scripted expert; it reads this task, which must outlive it. Unimplemented where there is
  // none; the message says what it lacks.
  virtual absl::StatusOr<Expert> MakeExpert() = 0;
  // One frame for a video: third-person and wrist view side by side.
  virtual absl::StatusOr<Image> Film(int height) = 0;
};

// A task's expert as a policy; `task` must outlive it.
absl::StatusOr<std::unique_ptr<PolicyEndpoint>> MakeExpertPolicy(SimTask& task);

// Embedded and LIBERO suites by name, with the unit's scenario and simulator options.
absl::StatusOr<std::unique_ptr<SimTask>> MakeSimTask(const UnitConfig& unit, int task);

// The instructions of the unit's suite in task order.
absl::StatusOr<std::vector<std::string>> SuiteInstructions(const UnitConfig& unit);

}  // namespace robostress
