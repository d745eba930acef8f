#pragma once

#include <array>
#include <functional>
#include <string>
#include <vector>

#include "absl/status/status.h"
#include "common/random.h"

namespace robostress::generator {

// A link of an arm and the joint that carries it.
struct SpatialLink {
  std::string joint, link;
  std::array<double, 3> xyz, rpy;  // of the joint's frame in the link before [m, rad about x, y, z]
  std::array<double, 3> axis;      // in the joint's frame
  double mass = 0;                 // [kg]
  std::array<double, 3> com;       // [m]
  // ixx, iyy, izz, ixy, ixz, iyz about the centre of mass, along the joint's frame [kg m^2].
  std::array<double, 6> inertia;
  double lower = 0, upper = 0, effort = 0;  // [rad, rad, Nm]
  // The real drive, of which a URDF says nothing: [kg m^2, Nm s/rad, Nm].
  double armature = 0, damping = 0, friction = 0;
  double kp = 0, kd = 0;               // servo [Nm/rad, Nm s/rad]
  double centre = 0, amplitude = 0.4;  // of its motion [rad]
};

// A serial arm on a fixed base, as its maker's figures say.
struct SpatialArm {
  std::string name;
  std::vector<SpatialLink> links;
  std::array<double, 3> tool = {0, 0, 0};  // of tool0 in the last link [m]
  double noise = 1e-4;                     // [rad] of a reading, standard deviation
};

SpatialArm So101();
SpatialArm Ur5e();
SpatialArm FrankaPanda();
SpatialArm Piper();

// As a ROS description package ships it: meshes that are not there, a transmission, a tool frame.
std::string UrdfOf(const SpatialArm& arm);
// The same rigid bodies, written by another hand; with `newer` as a collection for a newer MuJoCo
// has it, with meshes that are not there.
std::string MjcfOf(const SpatialArm& arm, bool newer);

// What one joint has and its model lacks.
struct SpatialFault {
  int joint = 0;
  double backlash = 0;  // half-width of the gap between motor and link, which is read [rad]
  std::function<double(double q, double dq)> torque;        // [Nm]; null: none
  std::function<double(double q, double dq)> dry_friction;  // limit [Nm]; null: the drive's own
};

// Runs all joints by their servos along two sines each, `seconds` at `rate_hz` rows, and returns
// the log as CSV: t, and q_cmd and q of every joint. MuJoCo's rigid bodies, steps of 0.25 ms, dry
// friction as an impulse that stops a joint at most.
std::string SimulatedLog(const SpatialArm& arm, const SpatialFault& fault, double seconds,
                         double rate_hz, double speed, RandomStream random);

// model file, three logs (two to fit, one held out) and a rig in which nothing of `fault` is
// declared, as a first rig has it. `format`: "urdf", "mjcf".
absl::Status WriteSpatialRig(const SpatialArm& arm, const SpatialFault& fault,
                             const std::string& format, const std::vector<std::string>& fit,
                             const std::string& folder);

}  // namespace robostress::generator
