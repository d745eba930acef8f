#pragma once

#include <mujoco/mujoco.h>

#include <Eigen/Core>
#include <cstdint>
#include <vector>

namespace robostress {

// mj_collision without the pairs that are too far apart to touch. MuJoCo 2.2.2 tests every geom of
// a body with every geom of each body near it, and of the world's; in LIBERO's kitchens, whose
// fixtures are built of boxes, half of a step goes into that. Here MuJoCo is given the pairs whose
// boxes or bounding spheres come within two centimetres of each other, and that list is made anew
// when something has moved by one (a Verlet list). Contacts, and their order, are mj_collision's to
// the bit, but for one case: two free bodies whose bounding boxes touch within the last digit of a
// float, which MuJoCo then takes for apart.
class NearGeoms {
 public:
  // The model must outlive it. Its options may change between steps; where bodies stand and how
  // geoms touch (friction, solref, solimp, condim, priority, gap), if Forget is called then; sizes,
  // margins, bits, exclusions and the tree must stay as they are.
  explicit NearGeoms(const mjModel& model);
  NearGeoms(const NearGeoms&) = delete;
  NearGeoms& operator=(const NearGeoms&) = delete;

  // In place of mj_collision: after mj_kinematics, before mj_makeConstraint.
  void Collide(mjData& data);
  // What was looked at does not hold any more.
  void Forget() { looked_ = false; }

 private:
  struct Geom {
    int id = -1, body = -1;
    double reach = 0;  // bounding radius, none of a plane, and margin [m]
    double margin = 0;
    bool plane = false;
    bool box = false;
  };
  // Geoms of bodies that are welded together: they move as one, and never touch each other.
  struct Group {
    std::vector<Geom> geoms;
    int weld = 0, parent_weld = 0;  // bodies
    Eigen::Vector3d centre;         // when it was looked at last
    double radius = 0;              // around it, margins included [m]
  };
  // What moves: a body with all that is welded to it, as it was looked at last.
  struct Mover {
    int body = -1;
    double radius = 0;  // of its farthest point from its origin, margins included [m]
    Eigen::Vector3d position;
    Eigen::Matrix3d turned;
  };

  // A body with a plane, fixed, and one near it. MuJoCo meets such a pair once for the plane and
  // once more where it sorts bodies by their boxes, and then makes each contact twice.
  struct PlaneMeeting {
    int plane_body = -1, body = -1;
    double reach = 0;  // their boxes are apart at sqrt(3) times this distance of their origins [m]
    bool twice = false;  // in near_ as it is shown
  };

  bool CanRun() const;
  bool Moved(const mjData& data) const;
  void Look(const mjData& data);
  void LookBetween(const mjData& data, const Group& group, const Group& other);
  void LookAtFixed(const mjData& data, const Group& group);
  bool Touchable(const mjData& data, const Geom& a, const Geom& b) const;
  void Add(const Geom& a, const Geom& b);
  void Describe(int first, int second);
  void FindMeetings(const mjData& data);
  // Whether any of meetings_ changed.
  bool UpdateMeetings(const mjData& data);
  bool BoxesMeet(const mjData& data, const Eigen::Matrix3d& frame, int a, int b) const;
  void Show();

  const mjModel& model_;
  bool usable_ = true;         // what is fixed of the model; see CanRun
  std::vector<Geom> fixed_;    // on the world and what is welded to it
  std::vector<Group> groups_;  // the others
  std::vector<Mover> movers_;
  std::vector<uint64_t> excluded_;  // pairs of bodies, sorted
  std::vector<bool> has_plane_;     // [bodies]
  std::vector<PlaneMeeting> meetings_;
  bool looked_ = false;
  std::vector<uint64_t> near_;  // pairs, in the order of mj_collision
  // They as MuJoCo reads pairs that a model defines.
  mjModel shown_;
  std::vector<int> dim_, geom1_, geom2_, signature_;
  std::vector<double> solref_, solimp_, margin_, gap_, friction_;
};

}  // namespace robostress
