#pragma once

#include <mujoco/mujoco.h>

#include <functional>
#include <memory>
#include <vector>

#include "sim_worker/panda_sim.h"

namespace robostress {

// The sub-steps of recorded control steps, to be taken again with mj_step alone: the same states,
// contacts, motor commands and warm starts, so the same physical work without a controller.
class BareSteps {
 public:
  explicit BareSteps(const mjModel& model);  // must outlive this

  // Takes a control step of `sim` by calling `step` and appends its sub-steps.
  void Record(PandaSim& sim, const std::function<void()>& step);
  // Control step `index`, bare: its 25 mj_step.
  void Run(int index);
  // Largest difference of a position between what Run reached and what was recorded [m, rad]; 0
  // where nothing but MuJoCo moves the joints.
  double largest_difference() const { return largest_difference_; }
  // Compares after the last Run.
  void Compare(int index);

 private:
  struct SubStep {
    std::vector<double> qpos, qvel, warmstart, ctrl;
  };
  struct DataDeleter {
    void operator()(mjData* data) const { mj_deleteData(data); }
  };
  SubStep StateOf(const mjData& data) const;

  const mjModel& model_;
  std::unique_ptr<mjData, DataDeleter> data_;
  std::vector<std::vector<SubStep>> steps_;
  std::vector<std::vector<double>> reached_;  // qpos at the end of each control step
  double largest_difference_ = 0;
};

// One control step beside its bare sub-steps, medians over repeats, means over steps.
struct StepCost {
  double ours_s = 0, bare_s = 0;                      // CPU time of a control step [s]
  double contacts = 0;                                // mean at the ends of control steps
  double replay_difference = 0;                       // see BareSteps
  double of_bare() const { return bare_s / ours_s; }  // 1: as fast as bare stepping
};

// An episode that can be repeated exactly.
struct TimedEpisode {
  PandaSim* sim;
  std::function<void()> reset;    // to the episode's start
  std::function<void(int)> step;  // control step t
};

// Takes the episode once to record it and then `repeats` times, each control step followed by its
// bare sub-steps, so that drift of the machine's speed meets both.
StepCost MeasureSteps(const TimedEpisode& episode, int steps, int repeats);

// A slow circle of the tool with the gripper at work: command of control step t, normalised.
Eigen::VectorXf CircleCommand(int step);

}  // namespace robostress
