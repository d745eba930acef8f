#pragma once

#include <mujoco/mujoco.h>

#include <array>
#include <cstdint>
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "absl/status/statusor.h"
#include "sim_worker/libero/numpy_random.h"
#include "sim_worker/libero/scene.h"

namespace robostress::libero {

// What one reset of the originals' environment leaves behind.
struct ResetDraw {
  std::vector<double> qpos;           // [nq] arm, fingers, objects, fixture joints
  std::vector<FixturePose> fixtures;  // those that an init atom places, by name
};

// The resets of one LIBERO environment (8f1084e on robosuite 1.4.0) that was constructed, seeded
// once with env.seed(seed), and is then reset again and again, as openpi's evaluation does. Draws
// come from NumPy's global generator in this order (robots/robot.py reset; bddl_base_domain.py
// _add_placement_initializer and _reset_internal; regions/*.py):
//   1. seven normals for the arm, times a noise magnitude of 0 (ControlEnv's default), so that the
//      posture is init_qpos exactly;
//   2. a joint coordinate for every open, close, turnon and turnoff atom. The list of these
//      samplers lives as long as the environment and grows with every model that is loaded, by the
//      constructor and by each reset: reset number k draws k + 2 times, the last draw counts;
//   3. objects and fixtures on the workspace in the order of the init atoms, then objects on and in
//      sites, then objects on objects. Each: the range's index, x, y, a test against everything
//      placed so far (at most 5000 tries), then the rotation.
// A failed placement starts the reset over, loads a model once more, and leaves the generator where
// it is. Not thread-safe.
class NumpyPlacement {
 public:
  // `scene` must outlive this. resets_before: those that went before the seed, >= 0.
  // InvalidArgument names file and line of an init atom that the originals cannot place.
  static absl::StatusOr<NumpyPlacement> Create(const LiberoScene& scene, uint32_t seed,
                                               int resets_before = 0);
  // The next env.reset(). ResourceExhausted when nothing fits again and again, where the originals
  // would not return.
  absl::StatusOr<ResetDraw> Reset();

 private:
  // Something that the originals place, with the parameters of its sampler.
  struct Placement {
    const LiberoObject* object = nullptr;
    std::vector<std::array<double, 4>> ranges;  // x0 y0 x1 y1 [m]
    double inset = 0;                           // [m] taken off every side of a range
    double z_offset = 0;                        // [m]
    bool must_be_free = true;                   // tested against everything placed so far
    const LiberoObject* reference = nullptr;    // placed before; null: the workspace
    bool on_top = true;                         // of the reference, else at its origin
    int site = -1;                              // added to the reference's position
    std::array<double, 2> yaw = {0, 0};         // fixtures [rad]
  };
  struct JointDraw {
    std::vector<int> joints;
    Articulation::Range range;
  };
  struct Pose {
    const LiberoObject* object;
    std::array<double, 3> pos;
    std::array<double, 4> quat;
  };
  using Poses = std::map<std::string, Pose>;

  NumpyPlacement(const LiberoScene& scene, uint32_t seed) : scene_(&scene), random_(seed) {}
  absl::Status AddAtom(const BddlAtom& atom);
  absl::Status AddJointDraw(const BddlAtom& atom);
  absl::Status AddPlacement(const BddlAtom& atom, const LiberoObject& object,
                            const BddlRegion& region);
  absl::StatusOr<Placement> OnSite(const BddlAtom& atom, const LiberoObject& object,
                                   const BddlRegion& region) const;
  absl::Status CheckOrder() const;
  void PrepareKinematics();

  void DrawJoints(std::vector<double>& qpos);
  bool Place(const Placement& placement, Poses& placed);
  std::array<double, 3> BaseOf(const Placement& placement, const Poses& placed) const;
  std::array<double, 4> DrawQuaternion(const Placement& placement);

  const LiberoScene* scene_;
  NumpyRandom random_;
  std::vector<JointDraw> joint_draws_;
  std::vector<Placement> on_workspace_, on_sites_, in_sites_, on_objects_;
  int models_loaded_ = 1;  // by the constructor
  // Positions of sites before anything is placed; only if an atom needs them.
  std::shared_ptr<mjModel> model_;
  std::shared_ptr<mjData> data_;
};

}  // namespace robostress::libero
