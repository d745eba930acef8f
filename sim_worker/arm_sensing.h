#pragma once

#include <deque>
#include <memory>

#include "absl/status/statusor.h"
#include "common/random.h"
#include "common/types.h"
#include "common/unit_config.h"
#include "sim_worker/panda_model.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

// What an arm knows of its own motion. PandaSim::Measure is the link side, exact and at once; a
// real arm has encoders, mostly at the motors, which are blind to backlash and compliance, with
// noise, and hears of them late. The gripper is not affected. For one simulator at a time; one
// thread.
class ArmSensing {
 public:
  // kNotFound, kInvalidArgument: of a model without a Panda (PandaModel::Find).
  static absl::StatusOr<std::unique_ptr<ArmSensing>> Create(SharedModel model,
                                                            const SensingOptions& options);
  ~ArmSensing();

  // The noise of an episode depends on its initial state alone.
  void StartEpisode(int initial_state);
  // Once per control step: the state of `delay` control steps ago, the episode's first one before
  // that. Its stamp, q [rad] and pose are those of then; dq [rad/s] too, without noise.
  RobotState Measure(const PandaSim& sim);

 private:
  ArmSensing(SharedModel model, const SensingOptions& options, const PandaModel& panda);
  RobotState Sense(const PandaSim& sim);

  const SharedModel model_;
  const SensingOptions options_;
  const PandaModel panda_;
  struct Kinematics;
  std::unique_ptr<Kinematics> kinematics_;
  RandomStream noise_;
  std::deque<RobotState> seen_;  // the newest last
};

}  // namespace robostress
