#pragma once

#include <Eigen/Core>
#include <string>

namespace robostress {

// A scene around our own MJCF of the Franka Panda with its gripper. Kinematics are the public ones;
// masses, inertias, damping, armature, friction loss, motors and the gripper's actuators carry
// robosuite 1.4.0's values, so that the controller and the error models meet the same dynamics as
// in LIBERO. Shapes are ours: capsules, boxes and cylinders.
//
// Names are robosuite's: robot0_base, robot0_link0..7, robot0_joint1..7, robot0_torq_j1..7,
// robot0_right_hand, robot0_eye_in_hand (camera), gripper0_right_gripper, gripper0_grip_site,
// gripper0_leftfinger / rightfinger, gripper0_finger_joint1/2, gripper0_gripper_finger_joint1/2,
// gripper0_finger1/2_pad_collision, gripper0_finger1/2_collision.
//
// Geom groups: 0 is collision only and never rendered, 1 is rendered. Group 1 is the default of a
// geom in `world_xml`, where a primitive may both collide and be seen; class "visual" is seen and
// does not collide, class "collision" collides and is not seen. Contact masks: robot geoms have
// contype 0 and conaffinity 1, so they never touch each other, and touch every geom with bit 1 in
// its contype (the MJCF default). Links 0 to 4 do not collide at all.
struct PandaScene {
  std::string name = "panda";
  std::string assets_xml;    // children of `<asset>`
  std::string defaults_xml;  // `<default class=...>` elements, children of the main default
  std::string world_xml;     // children of `<worldbody>`: tables, objects, lights, camera agentview
  std::string contact_xml;   // children of `<contact>`
  Eigen::Vector3d base_position = Eigen::Vector3d(-0.66, 0, 0.912);  // of robot0_base [m]

  // Solver. The defaults are those of the embedded suites (what they cost:
  // docs/results/simulator-speed.md).
  bool elliptic_cone = true;
  double impratio = 10;  // frictional to normal impedance: higher slips less
  int iterations = 20;   // Newton iterations, at most
  double tolerance = 1e-7;
  double density = 0;         // of the air [kg/m^3]; robosuite: 1.2
  double viscosity = 0;       // [Pa s]; robosuite: 2e-5
  int max_contacts = 200;     // nconmax
  int max_constraints = 800;  // njmax
};

// The scene as MJCF text for CompileModel. qpos starts with the seven arm joints and the two
// fingers.
std::string ComposePandaScene(const PandaScene& scene);

// The arm alone as a rig's model: no scene, no actuators, no contacts; the gripper is a fixed mass
// with its fingers half open. Inertials, damping, armature and friction loss are the scene's.
std::string ComposePandaArm();

// robosuite's home posture of the Panda in LIBERO [rad]: the tool points down, 3.3 degrees off the
// vertical.
Eigen::Matrix<double, 7, 1> PandaHome();
// Finger positions of a reset: half open [m].
Eigen::Vector2d PandaHomeFingers();

}  // namespace robostress
