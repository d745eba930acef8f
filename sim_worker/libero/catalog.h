#pragma once

#include <array>
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

// Resolves the two roots: the argument, else the environment variable LIBERO_ROOT / ROBOSUITE_ROOT.
// A root may be the checkout or the package folder inside it.
absl::StatusOr<LiberoPaths> FindLibero(const std::string& libero_root,
                                       const std::string& robosuite_root);

// Tasks of libero_spatial, libero_object, libero_goal and libero_10 in the benchmark's order
// (task_order_index 0; LIBERO 8f1084e, libero/libero/benchmark/libero_suite_task_map.py). NotFound
// lists the known suites.
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
  std::array<CameraPlacement, 4> cameras;  // in this order; an empty name ends the list
};
absl::StatusOr<ProblemClass> FindProblemClass(const std::string& name);

// Thresholds of an articulated category on each joint coordinate
// (envs/objects/articulated_objects.py).
struct Articulation {
  std::string_view category;
  bool open_below = true;      // open when q < open (cabinets, microwave), else q > open
  double open = 0, close = 0;  // closed when q lies beyond `close` on the other side
  bool has_switch = false;
  double on = 0, off = 0;  // turned on at q >= on, off at q < off
};
// nullptr for a category without movable parts.
const Articulation* FindArticulation(const std::string& category);

// The category's MJCF file below `libero`; NotFound names the folders that were searched.
absl::StatusOr<std::string> FindObjectFile(const LiberoPaths& paths, const std::string& category);

}  // namespace robostress::libero
