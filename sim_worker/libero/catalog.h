#pragma once

#include <array>
#include <numbers>
#include <string>
#include <string_view>
#include <vector>

#include "absl/status/statusor.h"

namespace robostress::libero {

// Where the user's checkouts are.
struct LiberoPaths {
  std::string libero;     // the package folder that holds assets/, bddl_files/, init_files/
  std::string robosuite;  // the folder robosuite/models/assets
};

// Resolves the two roots: the argument, else the environment variable LIBERO_ROOT / ROBOSUITE_ROOT,
// else what `robostress libero setup` linked. A root may be the checkout or the package folder
// inside it.
absl::StatusOr<LiberoPaths> FindLibero(const std::string& libero_root,
                                       const std::string& robosuite_root);

// libero_spatial, libero_object, libero_goal, libero_10.
std::vector<std::string> LiberoSuites();
// A suite's tasks in the benchmark's order (task_order_index 0; LIBERO 8f1084e,
// libero/libero/benchmark/libero_suite_task_map.py). NotFound lists the known suites.
absl::StatusOr<std::vector<std::string>> LiberoTaskNames(const std::string& suite);
// The instruction that the benchmark derives from a task's file name.
std::string LiberoInstruction(const std::string& task_name);

struct CameraPlacement {
  std::string_view name;
  std::array<double, 3> pos;   // [m] world
  std::array<double, 4> quat;  // w x y z
};

// What LIBERO's problem classes add to a BDDL file (envs/problems/*.py, envs/arenas/*.py,
// envs/robots/*.py).
struct ProblemClass {
  std::string_view name;           // problem name of the BDDL file, lower case
  std::string_view workspace;      // category of the table or floor: "table", "kitchen_table", ...
  std::string_view region_marker;  // a region whose name contains this lies on the workspace
  std::string_view scene;          // arena file in assets/
  std::string_view arena_body;     // body that gets the regions' sites
  bool has_table = false;          // the arena's table is resized and placed (the study's is not)
  std::array<double, 3> table_size;        // [m] full
  std::array<double, 3> workspace_offset;  // [m]
  std::string_view floor_texture, wall_texture;
  std::array<double, 3> table_friction;
  std::array<double, 3> robot_base;        // [m] before the mount's height is added
  bool mounted = true;                     // on the RethinkMount, else on nothing
  double fixture_z;                        // [m] added to a fixture's height
  bool zone_at_workspace = false;          // regions' sites are shifted by workspace_offset
  double zone_z;                           // [m] of a region's site in arena_body
  bool draws_inset = false;                // objects are drawn whole inside their region
  std::array<CameraPlacement, 4> cameras;  // in this order; an empty name ends the list
};
absl::StatusOr<ProblemClass> FindProblemClass(const std::string& name);

// Where LIBERO's init atoms put each joint coordinate of an articulated category, and the
// thresholds that follow from the same ranges (envs/objects/articulated_objects.py).
struct Articulation {
  using Range = std::array<double, 2>;  // low, high
  std::string_view category;
  bool open_below = true;  // open when q < open() (cabinets, microwave), else q > open()
  Range open_range = {}, close_range = {};
  bool has_switch = false;
  Range on_range = {}, off_range = {};

  constexpr double open() const { return open_below ? open_range[1] : open_range[0]; }
  // Closed when q lies beyond this on the other side.
  constexpr double close() const { return open_below ? close_range[0] : close_range[1]; }
  constexpr double on() const { return on_range[0]; }    // turned on at q >= on()
  constexpr double off() const { return off_range[1]; }  // turned off at q < off()
};
// nullptr for a category without movable parts.
const Articulation* FindArticulation(const std::string& category);

// How LIBERO turns a movable object when it draws its pose (envs/objects/*.py: rotation and
// rotation_axis; no class has an init_quat, so none is applied).
struct PlacementRotation {
  struct Turn {
    char axis = 0;             // 'x', 'y' or 'z'; 0: no turn
    double low = 0, high = 0;  // [rad]
  };
  std::string_view name;      // a category, or the folder of all other categories in it
  std::array<Turn, 3> turns;  // several: a dict in the originals, applied in this order
};
// The category's own rule, else that of the folder of its file (FindObjectFile's); NotFound if
// neither exists.
absl::StatusOr<PlacementRotation> FindPlacementRotation(const std::string& category,
                                                        const std::string& object_file);

// The Panda at a reset (init_qpos in LIBERO's envs/robots/*.py and robosuite's
// models/grippers/panda_gripper.py).
inline constexpr std::array<double, 7> kHomePosture = {
    0, -1.61037389e-01, 0, -2.44459747e+00, 0, 2.22675220e+00, std::numbers::pi / 4};  // [rad]
inline constexpr std::array<double, 2> kHomeFingers = {0.020833, -0.020833};           // [m]

// The category's MJCF file below `libero`; NotFound names the folders that were searched.
absl::StatusOr<std::string> FindObjectFile(const LiberoPaths& paths, const std::string& category);

}  // namespace robostress::libero
