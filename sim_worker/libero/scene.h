#pragma once

#include <mujoco/mujoco.h>

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "common/libero/bddl.h"
#include "sim_worker/libero/catalog.h"
#include "sim_worker/panda_sim.h"

namespace robostress::libero {

// A movable object or a fixture of the composed scene.
struct LiberoObject {
  std::string name, category;
  bool fixture = false;
  int body = -1;                   // its root body in the model
  std::vector<int> joints;         // all joints below its root, model indices, in the file's order
  std::vector<char> contact_geom;  // [ngeom] 1 for its collision geoms (group 0)
  const Articulation* articulation = nullptr;
  // What the originals' placement samplers know of it, from marker sites of its file [m]: heights
  // of bottom and top above its origin, radius around it.
  double bottom = 0, top = 0, horizontal_radius = 0;
  PlacementRotation rotation;
};

// A named region that goals speak of: a zone of the table or a site inside an object.
struct LiberoSite {
  std::string name;
  std::string parent;  // object or fixture that owns it; empty for a zone of the workspace
  int site = -1;
  std::vector<int> joints;  // of the innermost body that holds the site
};

// Where a welded fixture stands. The originals draw it at every reset; it is not part of an initial
// state.
struct FixturePose {
  std::string fixture;
  std::array<double, 3> pos;   // [m] world
  std::array<double, 4> quat;  // w x y z
};

// One task's compiled scene with what its predicates need to know.
struct LiberoScene {
  BddlProblem problem;
  ProblemClass problem_class;
  std::string mjcf;
  SharedModel model;  // compiled from it, as the originals compile it; fixtures stand where their
                      // files put them
  std::map<std::string, LiberoObject> objects;
  std::map<std::string, LiberoSite> sites;
  std::vector<FixturePose>
      centred_fixtures;         // each at the centre of its region and of its yaw range
  std::set<std::string> files;  // all that it is made of: MJCF, meshes, textures, missing ones too
  std::vector<std::string> missing_visuals;  // files that were replaced
  std::vector<int> replaced_geoms;           // visual geoms whose mesh was replaced
};

// Composes and compiles the scene of a parsed BDDL file in the originals' order: arena, robot with
// mount and gripper, objects, fixtures (LIBERO 8f1084e on robosuite 1.4.0). pictures = false: what
// only a renderer reads is replaced as if it were missing, so that no texture is decoded.
absl::StatusOr<LiberoScene> ComposeScene(const LiberoPaths& paths, BddlProblem problem,
                                         bool pictures = true);

// The poses drawn uniformly from the regions, a function of (key, fixture) only.
std::vector<FixturePose> SampleFixtures(const LiberoScene& scene, uint64_t key);

// Moves the fixtures in `model`, a copy of the scene's, as the originals do: body_pos and body_quat
// only. NotFound for a name that is not a fixture.
absl::Status MoveFixtures(const LiberoScene& scene, const std::vector<FixturePose>& poses,
                          mjModel& model);
// A copy for all but pictures: the textures' pixels, hundreds of megabytes, are left out. nullptr
// where memory is short.
std::shared_ptr<mjModel> CopyWithoutTextures(const mjModel& model);

// A copy of the scene's model with the fixtures moved, without textures.
absl::StatusOr<std::shared_ptr<mjModel>> PlaceFixtures(const LiberoScene& scene,
                                                       const std::vector<FixturePose>& poses);

// The scene's MJCF with its fixtures where they stand in `model`.
std::string PlacedMjcf(const LiberoScene& scene, const mjModel& model);

// A copy to simulate, with equal dynamics, without textures. The free objects' part of qpos0, which
// only a reset reads, is taken from `qpos`: in the composed model they overlap and overflow the
// contact buffers before the first reset. The constraint buffers hold kMaxConstraints instead of
// robosuite's 5000 rows, which costs 75 instead of 308 MB per simulator; the stored states and the
// reference trajectories need at most 226 contacts.
inline constexpr int kMaxConstraints = 2500;
std::shared_ptr<mjModel> MakeSimulationModel(const mjModel& model, const double* qpos);

// A copy for rendering, with the scene's textures: collision geoms hidden (originals: group 0), but
// shown in plain colours on bodies whose visual meshes are missing; marker sites hidden. Geometry
// and sizes are equal, so mjData of `model` can be rendered with it. The caller may toggle sites in
// it.
absl::StatusOr<std::shared_ptr<mjModel>> MakeRenderModel(const LiberoScene& scene,
                                                         const mjModel& model);

}  // namespace robostress::libero
