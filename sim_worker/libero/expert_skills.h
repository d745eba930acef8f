#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <functional>
#include <memory>
#include <optional>

#include "sim_worker/libero/expert_view.h"

namespace robostress::libero {

// What a skill wants of the tool in one control step.
struct ToolGoal {
  Eigen::Vector3d p = Eigen::Vector3d::Zero();  // of the grip site, world [m]
  Eigen::Quaterniond q;                         // of the hand body, world
  double gripper = -1;                          // -1 open, 1 closed
};

// The hand straight down, its fingers opening along the world's y axis turned by `yaw`: of the two
// ways, half a turn apart, the one that is nearer to the hand now.
Eigen::Quaterniond DownTurned(const ExpertView& view, double yaw);

// What a skill is about, whatever the arm does: what the tool goes for, where that shall end, world
// [m], and whether the hand has it.
struct Aim {
  Eigen::Vector3d target, destination;
  bool holding = false;
};

// One way to change the scene, as a function of the state alone: whoever drove the arm there, the
// skill says what to do next. So its commands can be asked for along a policy's own way.
class ExpertSkill {
 public:
  virtual ~ExpertSkill() = default;
  virtual ToolGoal Decide(const ExpertView& view) const = 0;
  virtual Aim Look(const ExpertView& view) const = 0;
};

// Where an object shall be let go.
struct Place {
  Eigen::Vector3d p;           // of its body's origin [m]
  double over = 0;             // [m] above p it may be let go
  double beside = 0.012;       // [m] horizontally
  std::optional<double> turn;  // yaw of the hand then [rad]
  // Into something with a roof: held by its handle, it goes in along this way [m], whose end is p.
  std::optional<Eigen::Vector3d> way;
};

// Picks an object up from above and puts it down at a place.
std::unique_ptr<ExpertSkill> MakePickAndPlace(const LiberoObject& object,
                                              std::function<Place(const ExpertView&)> place);
// The bar of a cabinet's drawer, a geom; -1 if it has none.
int DrawerBar(const mjModel& model, int joint);
// Pulls a drawer open by its bar; pushes it shut.
std::unique_ptr<ExpertSkill> MakePullDrawer(const mjModel& model, int joint);
std::unique_ptr<ExpertSkill> MakeShutDrawer(const mjModel& model, int joint);
// Turns a stove's knob by its ridge, on or off.
std::unique_ptr<ExpertSkill> MakeTurnKnob(const mjModel& model, int joint, bool on);
// Pushes a flat object over the table, from behind.
std::unique_ptr<ExpertSkill> MakePush(const LiberoObject& object,
                                      std::function<Eigen::Vector3d(const ExpertView&)> place);
// Pulls a door on a vertical hinge open by its upright bar; pushes it shut. Null where it has no
// bar or no leaf.
std::unique_ptr<ExpertSkill> MakePullDoor(const mjModel& model, int joint);
std::unique_ptr<ExpertSkill> MakeShutDoor(const mjModel& model, int joint);

}  // namespace robostress::libero
