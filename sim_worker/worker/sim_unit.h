#pragma once

#include <functional>
#include <memory>
#include <string>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/records/episode_recording.h"
#include "common/rollout/command_inversion.h"
#include "common/rollout/policy_endpoint.h"
#include "common/rollout/robot.h"
#include "common/rollout/session_spec.h"
#include "common/types.h"
#include "common/unit/unit_runner.h"
#include "common/unit_config.h"
#include "sim_worker/joint_log.h"

namespace robostress {

// What a recording keeps of the moment before a step.
struct RecordedMoment {
  Observation observation;  // as no method changes it
  SimulatorRow simulator;
};

// One task of a suite as the runner sees it; the callbacks may be used while `robot` lives.
struct UnitTask {
  std::shared_ptr<Robot> robot;
  std::function<absl::StatusOr<std::unique_ptr<PolicyEndpoint>>()> make_expert;
  std::function<absl::StatusOr<Image>(int height)> film;           // one frame, height [px]
  std::string name, problem;                                       // of the task (sim_task.h)
  std::function<std::string()> mjcf;                               // its scene after the last reset
  std::function<absl::StatusOr<RecordedMoment>(int side)> moment;  // views of side x side [px]
  // Null unless the method has a model of the arm.
  std::shared_ptr<CommandInversion> inversion;
  // Sets who gets the joints of every sub-step; null where the robot has no such record.
  std::function<void(std::function<void(const JointSample&)>)> listen_to_joints;
};
using TaskFactory = std::function<absl::StatusOr<UnitTask>(const UnitConfig& unit, int task)>;

struct SimUnitOptions {
  UnitRunOptions run;
  std::string server;             // HOST:PORT for every policy but expert and replay
  double connect_timeout_s = 20;  // [s]
  double call_timeout_s = 300;    // [s]
  // Adds the lag of each episode to its row (sim_episode_row.h); changes nothing else in it.
  bool measure_lag = false;
  // Writes joints/task{T}_episode{E}.safetensors (joint_log.h) beside each row; changes no row.
  bool record_joints = false;
  // Above 0: writes episodes/task{T}_episode{E}.safetensors (episode_recording.h) with views of as
  // many pixels a side; changes no row.
  int record_views = 0;
  std::map<std::string, std::string> notes;  // further entries of provenance.json
};

// Runs what is missing of a unit of the simulated Panda (RunUnit). An adapting unit takes its
// session up again from the state that was published with its last row.
absl::Status RunSimUnit(const UnitConfig& unit, const SimUnitOptions& options,
                        const TaskFactory& make_task);

RequestedSession SessionOf(const UnitConfig& resolved);

}  // namespace robostress
