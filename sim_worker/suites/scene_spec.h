#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

namespace robostress {

// What a thing on the table is. shapes.h says how each kind looks, collides and is grasped.
enum class PropKind {
  kPot,
  kCube,
  kCan,
  kBottle,
  kBrick,  // can be picked up
  kPlate,
  kBasket,
  kBox,
  kMat,
  kRack,  // something can be put on or in them
  kCabinet,
  kStove,  // have a drawer, a knob
  kCup,    // a landmark
};

// A thing on the table, and where an episode may find it.
struct Prop {
  std::string name;  // its MJCF body: "red_pot"
  PropKind kind = PropKind::kCube;
  std::string color;  // of shapes.h
  std::string
      anchor;  // `position` is relative to this prop, which precedes it; empty: the robot's base
  Eigen::Vector2d position = Eigen::Vector2d::Zero();  // [m]
  Eigen::Vector2d jitter = Eigen::Vector2d::Zero();    // uniform in +-jitter [m]
  bool on_anchor = false;                              // stands on the anchor, not beside it
};

enum class GoalKind {
  kPlace,   // object rests on or in destination, let go
  kOpen,    // object's drawer is open
  kTurnOn,  // object's knob is turned
  kPush,    // object lies at destination, without being lifted
};

// One predicate of a task; all of a task's goals must hold at once, the expert reaches them in
// order.
struct Goal {
  GoalKind kind = GoalKind::kPlace;
  std::string object;
  std::string destination;  // prop; "cabinet/drawer" is the drawer's inside
  Eigen::Vector2d offset =
      Eigen::Vector2d::Zero();  // where the expert aims, from the region's centre [m]
};

struct SceneSpec {
  std::vector<Prop> props;
};

// A task is what the instruction asks for in a scene that it shares with other tasks.
struct TaskSpec {
  std::string instruction;
  int scene = 0;
  std::vector<Goal> goals;
};

struct SuiteSpec {
  std::string name;
  std::vector<SceneSpec> scenes;
  std::vector<TaskSpec> tasks;
};

// The embedded suites; nullptr for any other name.
const SuiteSpec* FindSuiteSpec(const std::string& name);

// One file each.
SuiteSpec TabletopSpatial();
SuiteSpec TabletopObject();
SuiteSpec TabletopGoal();
SuiteSpec TabletopLong();

}  // namespace robostress
