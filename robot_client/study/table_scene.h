#pragma once

#include <Eigen/Core>

#include "absl/status/statusor.h"
#include "robot_client/emulator/piper_plant.h"
#include "robot_client/study/table_tasks.h"

namespace robostress::piper {

// What can be known of the table at one moment; base frame [m].
struct TableState {
  Eigen::Vector3d bowl, plate, handle, grip;
  bool bowl_upright = false;
  double bowl_speed = 0;  // [m/s]
  double drawer = 0;      // pulled out by
  double opening = 0;     // between the fingers
};

// Objects of a table scene: where they start, where they are, and whether the task is done.
class TableScene {
 public:
  // Initial states below this are for evaluation, from it on for demonstrations.
  static constexpr int kFirstTrainingState = 1000;
  static constexpr double kDrawerOpen = 0.07;  // [m]

  // `plant` was made from MakeTableScene, and outlives this.
  static absl::StatusOr<TableScene> Create(PiperPlant* plant, const TableTask& task);

  // Puts every object where initial state `state` has it: drawn around the task's places, a
  // function of task and state only. The arm stays where it is; nothing may stand in it.
  void Place(int state);
  TableState Look() const;
  // Tasks 1 to 3: the bowl stands still and upright on the plate, and the fingers have let go of
  // it. Task 4: the drawer is open by kDrawerOpen.
  bool Done(const TableState& state) const;
  const TableTask& task() const { return *task_; }

 private:
  TableScene() = default;
  PiperPlant* plant_ = nullptr;
  const TableTask* task_ = nullptr;
  int bowl_ = 0, plate_ = 0, drawer_qpos_ = 0, drawer_dof_ = 0, bowl_qpos_ = 0, bowl_dof_ = 0;
  int handle_ = 0, grip_ = 0;  // sites
  int plate_mocap_ = 0, box_mocap_ = 0, cabinet_mocap_ = 0;
};

}  // namespace robostress::piper
