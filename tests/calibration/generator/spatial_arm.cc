#include "tests/calibration/generator/spatial_arm.h"

#include <Eigen/Dense>
#include <cmath>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"

namespace robostress::generator {
namespace {

constexpr double kQuarter = M_PI / 2;

// Of a solid rod about its centre, along axis 0, 1 or 2 [kg m^2].
std::array<double, 6> Rod(double mass, double length, double radius, int along) {
  const double across = mass * (3 * radius * radius + length * length) / 12;
  std::array<double, 6> inertia = {across, across, across, 0, 0, 0};
  inertia[static_cast<size_t>(along)] = mass * radius * radius / 2;
  return inertia;
}

std::string Triple(const std::array<double, 3>& v) {
  return absl::StrFormat("%.17g %.17g %.17g", v[0], v[1], v[2]);
}

// R = Rz(yaw) Ry(pitch) Rx(roll), as URDF has it; w x y z.
std::string Quaternion(const std::array<double, 3>& rpy) {
  const Eigen::Quaterniond q = Eigen::AngleAxisd(rpy[2], Eigen::Vector3d::UnitZ()) *
                               Eigen::AngleAxisd(rpy[1], Eigen::Vector3d::UnitY()) *
                               Eigen::AngleAxisd(rpy[0], Eigen::Vector3d::UnitX());
  return absl::StrFormat("%.17g %.17g %.17g %.17g", q.w(), q.x(), q.y(), q.z());
}

void SetDrives(SpatialArm& arm, const std::vector<std::array<double, 5>>& drives) {
  for (size_t i = 0; i < drives.size(); ++i) {
    SpatialLink& link = arm.links[i];
    link.armature = drives[i][0], link.damping = drives[i][1], link.friction = drives[i][2];
    link.kp = drives[i][3], link.kd = drives[i][4];
  }
}

}  // namespace

// Lengths, masses and limits, rounded, as TheRobotStudio's SO-ARM100 repository gives them for the
// SO-101 (Simulation/SO101); axes and frames are our own. Servo: Feetech STS3215, 12 bits a turn.
SpatialArm So101() {
  SpatialArm arm;
  arm.name = "so101";
  arm.links = {{"shoulder_pan",
                "shoulder",
                {0.021, 0, 0.055},
                {0, 0, 0},
                {0, 0, 1},
                0.100,
                {0.03, 0, 0.025},
                Rod(0.100, 0.06, 0.025, 2),
                -1.92,
                1.92,
                10},
               {"shoulder_lift",
                "upper_arm",
                {0.030, 0, 0.054},
                {0, 0, 0},
                {0, 1, 0},
                0.103,
                {0.008, 0.018, 0.090},
                Rod(0.103, 0.11, 0.02, 2),
                -1.745,
                1.745,
                10},
               {"elbow_flex",
                "lower_arm",
                {0.028, 0, 0.1126},
                {0, 0, 0},
                {0, 1, 0},
                0.104,
                {0.098, 0.018, 0.003},
                Rod(0.104, 0.13, 0.02, 0),
                -1.69,
                1.69,
                10},
               {"wrist_flex",
                "wrist",
                {0.1349, 0, 0.005},
                {0, 0, 0},
                {0, 1, 0},
                0.079,
                {0.039, 0.028, 0},
                Rod(0.079, 0.05, 0.02, 0),
                -1.658,
                1.658,
                10},
               {"wrist_roll",
                "gripper",
                {0.0611, 0, 0.018},
                {0, 0, 0},
                {1, 0, 0},
                0.087,
                {0.025, 0, 0},
                Rod(0.087, 0.06, 0.02, 0),
                -2.793,
                2.793,
                10},
               {"gripper",
                "moving_jaw",
                {0.0234, 0.020, 0.019},
                {0, 0, 0},
                {0, 0, 1},
                0.012,
                {0.030, -0.002, 0.019},
                Rod(0.012, 0.06, 0.008, 0),
                -0.175,
                1.745,
                10}};
  arm.tool = {0.098, 0, -0.008};
  SetDrives(arm, {{0.028, 0.06, 0.05, 17, 0.6},
                  {0.028, 0.06, 0.05, 17, 0.6},
                  {0.028, 0.06, 0.05, 17, 0.6},
                  {0.028, 0.06, 0.05, 17, 0.6},
                  {0.028, 0.06, 0.05, 17, 0.6},
                  {0.028, 0.06, 0.05, 17, 0.6}});
  arm.links[1].centre = 0.3, arm.links[2].centre = 0.4, arm.links[5].centre = 0.6;
  arm.noise = 4.4e-4;  // of 2 pi / 4096, uniform
  return arm;
}

// Universal Robots, "DH parameters for calculations of kinematics and dynamics": a, d, alpha,
// masses and centres of mass of the UR5e, in joint frames. Torques: "Max joint torques". Inertias
// are of rods, because the article has none.
SpatialArm Ur5e() {
  SpatialArm arm;
  arm.name = "ur5e";
  arm.links = {{"shoulder_pan_joint",
                "shoulder_link",
                {0, 0, 0},
                {0, 0, 0},
                {0, 0, 1},
                3.761,
                {0, -0.0019, 0.1369},
                Rod(3.761, 0.15, 0.06, 2),
                -6.283,
                6.283,
                150},
               {"shoulder_lift_joint",
                "upper_arm_link",
                {0, 0, 0.1625},
                {kQuarter, 0, 0},
                {0, 0, 1},
                8.058,
                {-0.2125, 0, 0.1134},
                Rod(8.058, 0.425, 0.06, 0),
                -6.283,
                6.283,
                150},
               {"elbow_joint",
                "forearm_link",
                {-0.425, 0, 0},
                {0, 0, 0},
                {0, 0, 1},
                2.846,
                {-0.2422, 0, 0.0265},
                Rod(2.846, 0.392, 0.05, 0),
                -3.1416,
                3.1416,
                150},
               {"wrist_1_joint",
                "wrist_1_link",
                {-0.3922, 0, 0},
                {0, 0, 0},
                {0, 0, 1},
                1.37,
                {0, -0.0163, 0.1315},
                Rod(1.37, 0.12, 0.045, 2),
                -6.283,
                6.283,
                28},
               {"wrist_2_joint",
                "wrist_2_link",
                {0, 0, 0.1333},
                {kQuarter, 0, 0},
                {0, 0, 1},
                1.3,
                {0, 0.0163, 0.0979},
                Rod(1.3, 0.12, 0.045, 2),
                -6.283,
                6.283,
                28},
               {"wrist_3_joint",
                "wrist_3_link",
                {0, 0, 0.0997},
                {-kQuarter, 0, 0},
                {0, 0, 1},
                0.365,
                {0, 0, 0.0984},
                Rod(0.365, 0.05, 0.04, 2),
                -6.283,
                6.283,
                28}};
  arm.tool = {0, 0, 0.0996};
  SetDrives(arm, {{1.2, 8, 6, 8000, 400},
                  {1.2, 8, 6, 8000, 400},
                  {1.2, 8, 5, 8000, 400},
                  {0.3, 2, 1.5, 1500, 60},
                  {0.3, 2, 1.5, 1500, 60},
                  {0.3, 2, 1.5, 1500, 60}});
  arm.links[1].centre = -1.2, arm.links[2].centre = 1.2, arm.links[3].centre = -1.5;
  arm.links[4].centre = -1.5;
  arm.noise = 2e-5;
  return arm;
}

// Kinematics: Franka's documentation, Denavit-Hartenberg parameters (Craig). Masses and centres of
// mass, rounded: C. Gaz et al., "Dynamic Identification of the Franka Emika Panda Robot With
// Retrieval of Feasible Parameters", RA-L 4(4), 2019. Inertias are of rods.
SpatialArm FrankaPanda() {
  SpatialArm arm;
  arm.name = "panda";
  arm.links = {{"joint1",
                "link1",
                {0, 0, 0.333},
                {0, 0, 0},
                {0, 0, 1},
                4.97,
                {0.004, 0.002, -0.175},
                Rod(4.97, 0.3, 0.06, 2),
                -2.8973,
                2.8973,
                87},
               {"joint2",
                "link2",
                {0, 0, 0},
                {-kQuarter, 0, 0},
                {0, 0, 1},
                0.647,
                {-0.003, -0.029, 0.003},
                Rod(0.647, 0.3, 0.06, 1),
                -1.7628,
                1.7628,
                87},
               {"joint3",
                "link3",
                {0, -0.316, 0},
                {kQuarter, 0, 0},
                {0, 0, 1},
                3.23,
                {0.028, 0.039, -0.067},
                Rod(3.23, 0.2, 0.06, 2),
                -2.8973,
                2.8973,
                87},
               {"joint4",
                "link4",
                {0.0825, 0, 0},
                {kQuarter, 0, 0},
                {0, 0, 1},
                3.59,
                {-0.053, 0.104, 0.027},
                Rod(3.59, 0.2, 0.06, 1),
                -3.0718,
                -0.0698,
                87},
               {"joint5",
                "link5",
                {-0.0825, 0.384, 0},
                {-kQuarter, 0, 0},
                {0, 0, 1},
                1.23,
                {-0.012, 0.041, -0.038},
                Rod(1.23, 0.25, 0.05, 2),
                -2.8973,
                2.8973,
                12},
               {"joint6",
                "link6",
                {0, 0, 0},
                {kQuarter, 0, 0},
                {0, 0, 1},
                1.67,
                {0.060, -0.014, -0.011},
                Rod(1.67, 0.12, 0.05, 0),
                -0.0175,
                3.7525,
                12},
               {"joint7",
                "link7",
                {0.088, 0, 0},
                {kQuarter, 0, 0},
                {0, 0, 1},
                0.736,
                {0.011, -0.004, 0.062},
                Rod(0.736, 0.1, 0.05, 2),
                -2.8973,
                2.8973,
                12}};
  arm.tool = {0, 0, 0.107};
  SetDrives(arm, {{0.6, 0.5, 0.4, 2000, 60},
                  {0.6, 0.5, 0.4, 2000, 60},
                  {0.6, 0.5, 0.4, 2000, 60},
                  {0.6, 0.5, 0.4, 2000, 60},
                  {0.2, 0.3, 0.3, 800, 20},
                  {0.2, 0.3, 0.3, 800, 20},
                  {0.2, 0.3, 0.3, 800, 20}});
  arm.links[3].centre = -1.8, arm.links[5].centre = 1.8, arm.links[6].centre = 0.8;
  arm.noise = 2e-5;
  return arm;
}

// Joint origins, masses and limits, rounded, as AgileX' piper_ros gives them (2025); the gripper
// rides on the last link. Inertias are of rods.
SpatialArm Piper() {
  SpatialArm arm;
  arm.name = "piper";
  arm.links = {{"joint1",
                "link1",
                {0, 0, 0.123},
                {0, 0, 0},
                {0, 0, 1},
                0.71,
                {0, 0, -0.01},
                Rod(0.71, 0.07, 0.04, 2),
                -2.618,
                2.618,
                100},
               {"joint2",
                "link2",
                {0, 0, 0},
                {kQuarter, -0.1359, -M_PI},
                {0, 0, 1},
                1.16,
                {0.198, 0, 0},
                Rod(1.16, 0.285, 0.03, 0),
                0,
                3.14,
                100},
               {"joint3",
                "link3",
                {0.28503, 0, 0},
                {0, 0, -1.7939},
                {0, 0, 1},
                0.5,
                {-0.02, -0.13, 0},
                Rod(0.5, 0.2, 0.03, 1),
                -2.967,
                0,
                100},
               {"joint4",
                "link4",
                {-0.022, -0.25075, 0},
                {kQuarter, 0, 0},
                {0, 0, 1},
                0.38,
                {0, 0, -0.004},
                Rod(0.38, 0.07, 0.03, 2),
                -1.745,
                1.745,
                100},
               {"joint5",
                "link5",
                {0, 0, 0},
                {-kQuarter, 0, 0},
                {0, 0, 1},
                0.383,
                {0, -0.056, 0},
                Rod(0.383, 0.09, 0.03, 1),
                -1.22,
                1.22,
                100},
               {"joint6",
                "link6",
                {0, -0.091, 0},
                {kQuarter, 0, 0},
                {0, 0, 1},
                0.75,
                {0, 0, 0.09},
                Rod(0.75, 0.14, 0.04, 2),
                -2.094,
                2.094,
                100}};
  arm.tool = {0, 0, 0.1358};
  SetDrives(arm, {{0.05, 0.4, 0.25, 80, 6},
                  {0.05, 0.4, 0.25, 250, 12},
                  {0.05, 0.4, 0.25, 250, 12},
                  {0.03, 0.3, 0.15, 60, 2},
                  {0.03, 0.3, 0.15, 60, 2},
                  {0.03, 0.3, 0.15, 40, 2}});
  arm.links[1].centre = 1.4, arm.links[2].centre = -1.3;
  arm.noise = 3e-5;
  return arm;
}

std::string UrdfOf(const SpatialArm& arm) {
  std::string text =
      absl::StrCat("<?xml version=\"1.0\"?>\n<!-- expanded by xacro -->\n<robot name=\"", arm.name,
                   "\" xmlns:xacro=\"http://www.ros.org/wiki/xacro\">\n  <link name=\"world\"/>\n"
                   "  <link name=\"base_link\"/>\n  <joint name=\"base_joint\" type=\"fixed\">\n"
                   "    <parent link=\"world\"/>\n    <child link=\"base_link\"/>\n  </joint>\n");
  std::string parent = "base_link";
  for (const SpatialLink& l : arm.links) {
    const auto& I = l.inertia;
    const std::string mesh = absl::StrCat("<geometry><mesh filename=\"package://", arm.name,
                                          "_description/meshes/", l.link, ".dae\"/></geometry>");
    absl::StrAppend(&text, "  <link name=\"", l.link, "\">\n    <visual>", mesh,
                    "</visual>\n    <collision>", mesh, "</collision>\n");
    absl::StrAppendFormat(&text,
                          "    <inertial>\n      <mass value=\"%.17g\"/>\n      <origin rpy=\"0 0 "
                          "0\" xyz=\"%s\"/>\n      <inertia ixx=\"%.17g\" iyy=\"%.17g\" "
                          "izz=\"%.17g\" ixy=\"%.17g\" ixz=\"%.17g\" iyz=\"%.17g\"/>\n"
                          "    </inertial>\n  </link>\n",
                          l.mass, Triple(l.com), I[0], I[1], I[2], I[3], I[4], I[5]);
    absl::StrAppendFormat(&text,
                          "  <joint name=\"%s\" type=\"revolute\">\n    <origin xyz=\"%s\" "
                          "rpy=\"%s\"/>\n    <parent link=\"%s\"/>\n    <child link=\"%s\"/>\n"
                          "    <axis xyz=\"%s\"/>\n    <limit lower=\"%.17g\" upper=\"%.17g\" "
                          "effort=\"%g\" velocity=\"3\"/>\n  </joint>\n",
                          l.joint, Triple(l.xyz), Triple(l.rpy), parent, l.link, Triple(l.axis),
                          l.lower, l.upper, l.effort);
    parent = l.link;
  }
  absl::StrAppend(&text,
                  "  <link name=\"tool0\"/>\n  <joint name=\"tool0_joint\" type=\"fixed\">\n",
                  "    <origin xyz=\"", Triple(arm.tool), "\"/>\n    <parent link=\"", parent,
                  "\"/>\n    <child link=\"tool0\"/>\n    <axis xyz=\"0 0 0\"/>\n  </joint>\n");
  return absl::StrCat(text, "  <transmission name=\"t\"><joint name=\"", arm.links[0].joint,
                      "\"/></transmission>\n</robot>\n");
}

std::string MjcfOf(const SpatialArm& arm, bool newer) {
  std::string text = absl::StrCat("<mujoco model=\"", arm.name,
                                  "\">\n<compiler angle=\"radian\" autolimits=\"true\"/>\n"
                                  "<option gravity=\"0 0 -9.81\"",
                                  newer ? " integrator=\"implicitfast\"" : "", "/>\n");
  if (newer)
    absl::StrAppend(&text,
                    "<default><default class=\"visual\"><geom type=\"mesh\"/></default></default>\n"
                    "<asset>\n<mesh file=\"link.obj\"/>\n</asset>\n");
  absl::StrAppend(&text, "<worldbody>\n<body name=\"base_link\">\n",
                  newer ? "<geom class=\"visual\" mesh=\"link\"/>\n" : "");
  for (const SpatialLink& l : arm.links) {
    const auto& I = l.inertia;
    absl::StrAppendFormat(
        &text,
        "<body name=\"%s\" pos=\"%s\" quat=\"%s\"%s>\n<inertial mass=\"%.17g\" pos=\"%s\" "
        "fullinertia=\"%.17g %.17g %.17g %.17g %.17g %.17g\"/>\n<joint name=\"%s\" axis=\"%s\" "
        "range=\"%.17g %.17g\"/>\n",
        l.link, Triple(l.xyz), Quaternion(l.rpy), newer ? " gravcomp=\"1\"" : "", l.mass,
        Triple(l.com), I[0], I[1], I[2], I[3], I[4], I[5], l.joint, Triple(l.axis), l.lower,
        l.upper);
    if (newer) absl::StrAppend(&text, "<geom class=\"visual\" mesh=\"link\"/>\n");
  }
  absl::StrAppend(&text, "<site name=\"tool\" pos=\"", Triple(arm.tool), "\"/>\n");
  for (size_t i = 0; i <= arm.links.size(); ++i) text += "</body>\n";
  text += "</worldbody>\n";
  if (newer) {
    text += "<actuator>\n";
    for (const SpatialLink& l : arm.links)
      absl::StrAppend(&text, "<position joint=\"", l.joint, "\" kp=\"", l.kp, "\" kv=\"", l.kd,
                      "\" inheritrange=\"1\"/>\n");
    text += "</actuator>\n";
  }
  return text + "</mujoco>\n";
}

}  // namespace robostress::generator
