#pragma once

#include <Eigen/Core>
#include <string>
#include <vector>

#include "sim_worker/suites/scene_spec.h"

namespace robostress {

// A place where something can be put: a horizontal rectangle in a body's frame.
struct Region {
  std::string body_suffix;  // of the prop's body that carries it: "" or "_drawer"
  Eigen::Vector3d center = Eigen::Vector3d::Zero();  // of the supporting surface [m]
  Eigen::Vector2d half = Eigen::Vector2d::Zero();  // where an object's origin counts as placed [m]
  double release_height =
      0.006;  // of the object's underside above the surface, when the expert lets go [m]
};

// What the tasks need to know of a kind of prop. Body frames lie at the centre of the underside.
struct ShapeInfo {
  double radius = 0;  // footprint, for the spacing of initial states [m]
  double height = 0;  // [m]
  bool graspable = false;
  double grasp_z = 0;      // height of the tool at the grasp [m]
  double grasp_width = 0;  // between the pads [m]
  bool has_region = false;
  Region region;
};

const ShapeInfo& ShapeOf(PropKind kind);
// The inside of a cabinet's drawer.
const Region& DrawerRegion();

// A handle that the gripper holds while a joint moves: drawer or knob.
struct Handle {
  std::string body_suffix;                           // body that carries it
  std::string joint_suffix;                          // its joint
  Eigen::Vector3d center = Eigen::Vector3d::Zero();  // in that body's frame [m]
  double width = 0;                                  // between the pads [m]
  double done = 0;  // joint position at which the goal holds [m or rad]
};
const Handle& DrawerHandle();  // of kCabinet: slides along -y
const Handle& KnobHandle();    // of kStove: turns about z, from -x towards +y

// How a prop is attached to the world. Only what a task moves has joints.
enum class Mobility {
  kStatic,  // a mocap body: placed per episode, never moves, touches nothing but what lies on it
  kFree,    // free joint NAME_joint
  kPlanar,  // slides NAME_x, NAME_y with dry friction: a plate that is pushed
};

// The prop's `<body>` element.
std::string PropMjcf(const Prop& prop, Mobility mobility);

// "r g b 1" of a colour's name.
std::string Rgba(const std::string& color);

}  // namespace robostress
