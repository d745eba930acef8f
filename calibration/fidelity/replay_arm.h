#pragma once

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "calibration/fidelity/payload_replay.h"
#include "common/random.h"
#include "sim_worker/panda_sim.h"
#include "sim_worker/suites/task_model.h"

namespace robostress::calibration {

// The pick-and-place task, and how commands reach the arm.
struct ReplayTask {
  std::string suite = "tabletop_spatial";
  int task = 0;
  SimOptions sim;
};

// What differs between replays of one demonstration.
struct ReplayConditions {
  Scenario scenario;                      // errors of the arm; default: Clean
  double command_sigma = 0;               // of Gaussian noise on the six motion commands
  StreamKey noise{"fidelity/noise"};      // of that noise
  Eigen::Matrix<double, 7, 1> q_offset =  // of the arm's start [rad]
      Eigen::Matrix<double, 7, 1>::Zero();
  Eigen::Vector2d object_offset = Eigen::Vector2d::Zero();  // of the object's place [m]
};

// What is replayed: the targets of the controller, as the arm was given them.
struct Demonstration {
  struct Target {
    Eigen::Vector3d p;  // world frame [m]
    Eigen::Matrix3d R;
    double gripper = 0;  // command
  };
  std::vector<Target> targets;                        // per control step
  std::vector<Eigen::Matrix<double, 7, 1>> commands;  // as the expert gave them
};

// A simulated Panda at one pick-and-place task whose object may be heavier than the model knows.
// The added mass sits at the object's centre; it hangs on the fingers by contact alone, and the
// controller, which compensates the arm's own weight, does not know of it. One thread per object.
class ReplayArm {
 public:
  // InvalidArgument where the task has no object to place.
  static absl::StatusOr<std::unique_ptr<ReplayArm>> Create(const ReplayTask& task,
                                                           double payload_kg);

  // The scripted expert carries the task out in closed loop under `scenario`; layout: initial state
  // of the suite. FailedPrecondition if it does not succeed within the horizon.
  absl::StatusOr<Demonstration> Record(int layout, const Scenario& scenario);
  // The same targets in open loop.
  absl::StatusOr<Replay> Run(int layout, const Demonstration& demonstration,
                             const ReplayConditions& conditions);

  const std::string& instruction() const { return model_->task().instruction; }
  double object_mass() const { return object_mass_; }  // without the payload [kg]

 private:
  ReplayArm() = default;
  std::vector<Eigen::Matrix<double, 7, 1>> Commands(const Demonstration& demonstration) const;

  ReplayTask task_;
  double object_mass_ = 0;
  int object_ = 0;  // index of the carried prop
  std::unique_ptr<TaskModel> model_;
  std::unique_ptr<PandaSim> sim_,
      recorder_;  // replaying; recording, whose goals are the originals'
};

}  // namespace robostress::calibration
