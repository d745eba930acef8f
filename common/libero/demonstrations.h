#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/hdf5_file.h"
#include "common/records/episode_recording.h"
#include "common/types.h"

namespace robostress {

// Demonstrations of one task in LIBERO's HDF5 form (scripts/create_dataset.py):
//   /data            attributes env_name, env_args, problem_info (JSON with language_instruction),
//                    bddl_file_name, macros_image_convention, num_demos, total
//   /data/demo_<i>   attributes num_samples, model_file (MJCF, fixtures where they stood),
//   init_state
//     actions [T,7], states [T,n] (time, qpos, qvel), robot_states [T,9] (fingers, position,
//     quaternion x y z w), rewards [T], dones [T] (1 in the last row
//     only; without success no reward is)
//     obs/  agentview_rgb, eye_in_hand_rgb  uint8 [T,H,W,3], the bottom row first as OpenGL draws
//           ee_pos [T,3] (world [m]), ee_ori [T,3] (axis-angle [rad]), ee_states [T,6] (both),
//           gripper_states [T,2] (fingers [m]), joint_states [T,7] [rad]
// Added by this project where a demonstration has them, ignored by LIBERO's readers:
//     obs/proprioception [T,8]  what the policy is given, where that is not ee_pos, ee_ori, fingers
//     obs/aux            [T,8]  targets of nano's auxiliary head
//     attribute initial_state   which of the task's initial states, or which draw
//     attribute origin          JSON: unit, scenario, method and so on, or the recorder's settings
//     actions_sent, actions_measured [T,7]  what was sent for `actions`, and what the arm did
// env_args, env_kwargs, controller_configs, control_delta says, as robosuite has it, whether
// actions are displacements (true, or nothing said: LIBERO's) or absolute targets (false). In
// LIBERO's own files row t of obs was taken after action t; here it is before, as a policy sees it.
// Images in memory have the top row first.

// A demonstration's numbers, row-major [T, .] columns of the table above.
struct LiberoColumns {
  int64_t steps = 0;
  std::vector<double> actions, ee_pos, ee_ori, gripper_states, joint_states;
  std::vector<double> states, robot_states;  // not read back
  std::vector<double> proprioception, aux;   // empty where absent
  std::vector<double> sent, measured;        // the same, and not read back

  // The simulator's part of a step.
  void Add(const SimulatorRow& row);
};

struct LiberoDemonstration {
  LiberoColumns columns;
  std::vector<Image> agentview, eye_in_hand;  // T each, one size
  std::string model_file;
  std::optional<int64_t> initial_state;
  bool success = true;
  std::string origin;  // JSON: which episode of what it is; empty: nothing is said
};

// Writes a file demonstration by demonstration.
class LiberoDemonstrationWriter {
 public:
  struct Task {
    std::string suite, task, instruction;
    int control_hz = 20;
    bool absolute_actions = false;  // targets, not displacements
    // LIBERO's class of the scene, by which its readers make an environment; empty: none of
    // LIBERO's.
    std::string problem = {};
  };
  static absl::StatusOr<LiberoDemonstrationWriter> Create(const std::string& path,
                                                          const Task& task);
  absl::Status Add(const LiberoDemonstration& demonstration);
  // Writes the counts and makes the file appear.
  absl::Status Publish();
  // What is written until then.
  const std::string& temporary() const { return file_.temporary(); }

 private:
  explicit LiberoDemonstrationWriter(Hdf5File file) : file_(std::move(file)) {}
  Hdf5File file_;
  int64_t demonstrations_ = 0, steps_ = 0;
};

// Reads a file; every size is checked when it is opened, every number when it is read.
class LiberoDemonstrationFile {
 public:
  enum class View { kAgent, kEyeInHand };
  static absl::StatusOr<LiberoDemonstrationFile> Open(const std::string& path);

  const std::string& path() const { return file_.path(); }
  const std::string& instruction() const { return instruction_; }
  int64_t demonstrations() const { return static_cast<int64_t>(entries_.size()); }
  int64_t steps(int64_t demonstration) const { return entries_[demonstration].steps; }
  // Whether all demonstrations carry what this project adds.
  bool has_proprioception() const { return has_proprioception_; }
  bool has_aux() const { return has_aux_; }
  bool absolute_actions() const { return absolute_actions_; }  // see control_delta above

  absl::StatusOr<LiberoColumns> ReadColumns(int64_t demonstration) const;
  // The view before action `step`, top row first.
  absl::StatusOr<Image> ReadView(int64_t demonstration, View view, int64_t step) const;

 private:
  struct Entry {
    std::string group;
    int64_t steps = 0;
    int height = 0, width = 0;
  };
  explicit LiberoDemonstrationFile(Hdf5File file) : file_(std::move(file)) {}
  absl::Status ReadTask();
  absl::StatusOr<Entry> CheckDemonstration(const std::string& group) const;

  Hdf5File file_;
  std::string instruction_;
  std::vector<Entry> entries_;  // in the order of their numbers
  bool bottom_row_first_ = true, has_proprioception_ = false, has_aux_ = false;
  bool absolute_actions_ = false;
};

}  // namespace robostress
