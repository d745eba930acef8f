#pragma once

#include <mujoco/mujoco.h>

#include <string>
#include <vector>

#include "absl/status/statusor.h"
#include "sim_worker/libero/scene.h"

namespace robostress::libero {

// The conjunction of a task's goal, with LIBERO's geometry (envs/predicates, envs/object_states,
// envs/objects/site_object.py at 8f1084e):
//   on A B (objects)  z_B <= z_A, some contact between their collision geoms, and
//                     |xy_A - xy_B| < 0.03 m of the body origins.
//   on A S (site)     d = R_S (p_A - p_S): size.z - 0.005 < d.z < size.z + 0.10, |d.x| < size.x,
//                     |d.y| < size.y; and contact between A and the site's owner, if it has one.
//   in A S            p_A strictly inside p_S +- |R_S size|, the lower z bound 0.01 m lower.
//   open / close T    any / every joint of T (an object's, or those of the innermost body around a
//                     site) beyond its category's threshold.
//   turnon / turnoff  likewise any / every.
//   up A              z_A >= 1 m.
// Quirks of the originals that are kept, each with a test:
//   - on a site turns by R_S where R_S' would lead into the site's frame;
//   - in takes the absolute value after the product, so a turned region shrinks, and asks for no
//     contact;
//   - a zone of the table has no owner: what hovers up to 10 cm above it is on it;
//   - a target without a joint is never open and always closed;
//   - rest is neither: a drawer at exactly 0 is not closed, a knob at exactly 0 is not off.
class LiberoGoal {
 public:
  // Resolves the names; an unknown predicate, object or wrong number of arguments is an error with
  // file and line. The scene must outlive the goal.
  static absl::StatusOr<LiberoGoal> Create(const LiberoScene& scene);
  // Reads positions and contacts as `data` holds them: after a step without a forward, those of the
  // start of the last sub-step, which is when the originals look.
  bool Holds(const mjData& data) const;
  // One value per atom of the goal.
  std::vector<bool> Evaluate(const mjData& data) const;

 private:
  enum class Kind { kOn, kIn, kOpen, kClose, kTurnOn, kTurnOff, kUp };
  struct Atom {
    Kind kind;
    const LiberoObject* object = nullptr;  // first argument
    const LiberoObject* target =
        nullptr;  // second argument, or of a unary predicate the articulated object
    const LiberoSite* site = nullptr;  // second argument, or of open / close the only one
    std::vector<int> joints;
  };
  bool Evaluate(const Atom& atom, const mjData& data) const;

  const LiberoScene* scene_ = nullptr;
  std::vector<Atom> atoms_;
};

// Whether any collision geom of `a` touches one of `b` in the contact list of `data`.
bool InContact(const mjData& data, const LiberoObject& a, const LiberoObject& b);

}  // namespace robostress::libero
