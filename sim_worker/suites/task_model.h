#pragma once

#include <mujoco/mujoco.h>

#include <Eigen/Core>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "sim_worker/panda_sim.h"
#include "sim_worker/suites/initial_states.h"
#include "sim_worker/suites/scene_spec.h"
#include "sim_worker/suites/shapes.h"

namespace robostress {

// A scene compiled for one of its tasks: what this task moves has joints, everything else is placed
// per episode and fixed, so that a control step costs what the task needs. It looks the same for
// every task.
class TaskModel {
 public:
  static absl::StatusOr<std::unique_ptr<TaskModel>> Create(const SuiteSpec& suite, int task);

  const SharedModel& model() const { return model_; }
  const std::string& mjcf() const { return mjcf_; }  // what model() was compiled from
  const SuiteSpec& suite() const { return *suite_; }
  const TaskSpec& task() const { return suite_->tasks[task_]; }
  int task_index() const { return task_; }

  // qpos of an initial state; the props without joints are placed by PlaceStaticProps.
  std::vector<double> Qpos(const InitialState& state) const;
  void PlaceStaticProps(const InitialState& state, mjData& data) const;

  // The true state, as predicates and the expert read it. Names are the scene's; the caller knows
  // them.
  const Prop& FindProp(const std::string& name) const;
  Eigen::Vector3d Position(const mjData& data, const std::string& body) const;
  double Upright(const mjData& data, const std::string& body) const;  // cosine of the tilt
  double JointPosition(const mjData& data, const std::string& joint) const;
  int BodyId(const std::string& body) const;
  // A goal's destination: its region and the centre of that region's surface now.
  const Region& RegionOf(const Goal& goal) const;
  Eigen::Vector3d RegionCenter(const mjData& data, const Goal& goal) const;
  Eigen::Vector3d HandleCenter(const mjData& data, const std::string& prop,
                               const Handle& handle) const;

 private:
  struct Entry {
    Mobility mobility = Mobility::kStatic;
    int qpos = -1;  // address of the first joint
    int mocap = -1;
  };
  TaskModel(const SuiteSpec& suite, int task) : suite_(&suite), task_(task) {}
  const SceneSpec& scene() const { return suite_->scenes[task().scene]; }
  Mobility MobilityOf(const Prop& prop) const;
  std::string SceneMjcf() const;

  const SuiteSpec* suite_;
  int task_;
  std::string mjcf_;
  SharedModel model_;
  std::vector<Entry> entries_;  // of the scene's props, in their order
};

}  // namespace robostress
