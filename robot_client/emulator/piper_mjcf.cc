#include "robot_client/emulator/piper_mjcf.h"

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <array>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "absl/strings/str_replace.h"
#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/link_inertia.h"

namespace robostress::piper {
namespace {

constexpr std::array<const char*, kJoints> kShapes = {{
    R"(<geom class="shell" type="capsule" size="0.045" fromto="0 0 -0.05 0 0 0.01"/>)",
    R"(<geom class="shell" type="capsule" size="0.035" fromto="0.02 0 0 0.27 0 0"/>)",
    R"(<geom class="shell" type="capsule" size="0.032" fromto="0 -0.02 0 -0.022 -0.19 0"/>)",
    R"(<geom class="shell" type="capsule" size="0.03" fromto="0 0 -0.05 0 0 0.01"/>)",
    R"(<geom class="shell" type="capsule" size="0.028" fromto="0 -0.01 0 0 -0.06 0"/>)",
    R"(<geom class="shell" type="cylinder" size="0.03 0.01" pos="0 0 -0.01"/>)",
}};

// Gripper base and fingers in the frame of link 6. The pads close at y = 0, 135.8 mm from it;
// their inertias are those of their boxes.
constexpr char kGripper[] = R"(
<body name="piper_gripper">
  %inertial
  <geom class="shell" type="box" size="0.03 0.05 0.03" pos="0 0 0.035"/>
  <site name="piper_tool" size="0.002" group="4"/>
  <site name="piper_grip" pos="0 0 0.1358" size="0.002" group="4"/>
  <camera name="piper_wrist_view" pos="-0.06 0 0.03" xyaxes="0 -1 0 -0.9659 0 0.2588" fovy="69"/>
  <body name="piper_finger1">
    <joint name="piper_finger1" class="finger" axis="0 -1 0"/>
    <geom class="pad" pos="0 -0.006 0.1058"/>
  </body>
  <body name="piper_finger2">
    <joint name="piper_finger2" class="finger" axis="0 1 0"/>
    <geom class="pad" pos="0 0.006 0.1058"/>
  </body>
  %s
</body>)";

// ixx iyy izz ixy ixz iyz about the centre of mass.
std::string FullInertia(const RigidPart& part) {
  const Eigen::Matrix3d& I = part.inertia;
  return absl::StrFormat("%.10g %.10g %.10g %.10g %.10g %.10g", I(0, 0), I(1, 1), I(2, 2), I(0, 1),
                         I(0, 2), I(1, 2));
}

// Frame of link i + 1 in its parent's at zero: Rot_x(alpha) Trans_x(a) Rot_z(theta) Trans_z(d).
std::string Placement(const DhRow& row) {
  const Eigen::Isometry3d T =
      Eigen::AngleAxisd(row.alpha, Eigen::Vector3d::UnitX()) * Eigen::Translation3d(row.a, 0, 0) *
      Eigen::AngleAxisd(row.theta, Eigen::Vector3d::UnitZ()) * Eigen::Translation3d(0, 0, row.d);
  const Eigen::Quaterniond q(T.linear());
  const Eigen::Vector3d p = T.translation();
  return absl::StrFormat("pos=\"%.12g %.12g %.12g\" quat=\"%.15g %.15g %.15g %.15g\"", p.x(), p.y(),
                         p.z(), q.w(), q.x(), q.y(), q.z());
}

std::string Link(int i, double payload_kg) {
  const RigidPart& part = LinkParts()[i];
  std::string inner;
  if (i + 1 < kJoints) {
    inner = Link(i + 1, payload_kg);
  } else {
    const std::string payload =
        payload_kg > 0
            ? absl::StrFormat(
                  R"(<body name="piper_payload" pos="0 0 0.1358"><geom class="payload" mass="%.9g"/></body>)",
                  payload_kg)
            : "";
    const RigidPart& gripper = GripperPart();
    inner = absl::StrReplaceAll(
        kGripper,
        {{"%inertial",
          absl::StrFormat(R"(<inertial pos="%.9g %.9g %.9g" mass="%.9g" fullinertia="%s"/>)",
                          gripper.centre.x(), gripper.centre.y(), gripper.centre.z(), gripper.mass,
                          FullInertia(gripper))},
         {"%s", payload}});
  }
  return absl::StrFormat(
      R"(<body name="piper_link%d" %s>
  <joint name="piper_joint%d" class="arm" range="%.4f %.4f"/>
  <inertial pos="%.9g %.9g %.9g" mass="%.9g" fullinertia="%s"/>
  %s
  %s
</body>)",
      i + 1, Placement(DhRows(Zero::kSince_1_6_3)[i]), i + 1, kJointStops[i].lower,
      kJointStops[i].upper, part.centre.x(), part.centre.y(), part.centre.z(), part.mass,
      FullInertia(part), kShapes[i], inner);
}

}  // namespace

std::string ComposePiperScene(const PiperScene& scene) {
  // Armature: MuJoCo Menagerie's agilex_piper. Finger stroke: the vendor's description.
  return absl::StrCat(R"(<mujoco model=")", scene.name, R"(">
<compiler angle="radian" autolimits="true"/>
<option timestep="0.001" integrator="Euler" cone="elliptic" impratio="10"/>
<size nconmax="200" njmax="800"/>
<visual><global offwidth="640" offheight="480"/></visual>
<default>
  <default class="arm"><joint type="hinge" axis="0 0 1" armature="0.005" solreflimit="0.005 1"/></default>
  <default class="finger"><joint type="slide" range="0 0.035" armature="0.1" damping="5"/></default>
  <default class="shell"><geom contype="0" conaffinity="1" mass="0" group="1" rgba="0.85 0.86 0.9 1"/></default>
  <default class="pad"><geom type="box" size="0.012 0.006 0.03" mass="0.1" contype="0" conaffinity="1" condim="4" friction="1.2 0.02 0.001" group="1" rgba="0.2 0.2 0.22 1"/></default>
  <default class="payload"><geom type="sphere" size="0.03" contype="0" conaffinity="0" group="1" rgba="0.6 0.3 0.2 1"/></default>
</default>
<asset>)",
                      scene.assets_xml, R"(</asset>
<worldbody>
  <light pos="0.3 0.3 1.5" dir="-0.1 -0.1 -1" diffuse="0.7 0.7 0.7"/>
  <camera name="piper_base_view" pos="0.75 0 0.55" xyaxes="0 1 0 -0.64 0 0.77" fovy="58"/>
  )",
                      scene.world_xml, R"(
  <body name="piper_base">
    <inertial pos="-0.00474 0.00003 0.04145" mass="1.02" fullinertia="0.00267433 0.00282612 0.00089624 -0.00000073 -0.00017389 0.0000004"/>
    <geom class="shell" type="cylinder" size="0.06 0.035" pos="0 0 0.035"/>
    )",
                      Link(0, scene.payload_kg), R"(
  </body>
</worldbody>
<equality><joint joint1="piper_finger1" joint2="piper_finger2" polycoef="0 1 0 0 0" solref="0.004 1"/></equality>
</mujoco>)");
}

}  // namespace robostress::piper
