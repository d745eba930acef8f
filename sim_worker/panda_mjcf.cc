#include "sim_worker/panda_mjcf.h"

#include <array>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_format.h"
#include "common/robot_description.h"

namespace robostress {
namespace {

// One link of the arm: its frame in the parent's, its inertial and its joint (none for link 0),
// whose limits are the description's.
struct Link {
  const char* pos;
  const char* quat;
  const char* com;
  double mass, inertia;      // [kg], diagonal [kg m^2]
  double damping, armature;  // [Nm s/rad], [kg m^2]
  const char* shape_xml;     // what is seen, and what collides
};

// Public Denavit-Hartenberg data of the Panda; inertials and joint constants as in robosuite 1.4.0.
constexpr std::array<Link, 8> kLinks = {{
    {"0 0 0", "1 0 0 0", "0 0 0.05", 4, 0.4, 0, 0,
     R"(<geom class="shell" type="cylinder" size="0.072 0.022" pos="-0.01 0 0.022"/>
        <geom class="shell" type="capsule" size="0.058" fromto="-0.04 0 0.06 0 0 0.13"/>
        <geom class="trim" type="cylinder" size="0.06 0.012" pos="0 0 0.188"/>)"},
    {"0 0 0.333", "1 0 0 0", "0 0 -0.07", 3, 0.3, 0.1, 5.0,
     R"(<geom class="shell" type="capsule" size="0.058" fromto="0 0 -0.13 0 0 -0.04"/>
        <geom class="shell" type="capsule" size="0.056" fromto="0 -0.045 0 0 0.045 0"/>)"},
    {"0 0 0", "0.7071067811865476 -0.7071067811865476 0 0", "0 -0.1 0", 3, 0.3, 0.1, 2.5,
     R"(<geom class="trim" type="cylinder" size="0.057 0.062"/>
        <geom class="shell" type="capsule" size="0.054" fromto="0 -0.05 0 0 -0.15 0"/>)"},
    {"0 -0.316 0", "0.7071067811865476 0.7071067811865476 0 0", "0.04 0 -0.05", 2, 0.2, 0.1,
     5.0 / 3,
     R"(<geom class="shell" type="capsule" size="0.053" fromto="0 0 -0.12 0 0 -0.06"/>
        <geom class="shell" type="capsule" size="0.05" fromto="0.02 0 -0.02 0.0825 -0.03 0"/>)"},
    {"0.0825 0 0", "0.7071067811865476 0.7071067811865476 0 0", "-0.04 0.05 0", 2, 0.2, 0.1, 1.25,
     R"(<geom class="trim" type="cylinder" size="0.05 0.055"/>
        <geom class="shell" type="capsule" size="0.05" fromto="-0.02 0.02 0 -0.0825 0.09 0"/>)"},
    {"-0.0825 0.384 0", "0.7071067811865476 -0.7071067811865476 0 0", "0 0 -0.15", 2, 0.2, 0.1, 1.0,
     R"(<geom class="shell" type="capsule" size="0.05" fromto="0 0 -0.28 0 0.05 -0.19"/>
        <geom class="shell" type="capsule" size="0.042" fromto="0 0.06 -0.17 0 0.06 -0.02"/>
        <geom class="collision" type="capsule" size="0.055" fromto="0 0.03 -0.25 0 0.04 -0.02"/>)"},
    {"0 0 0", "0.7071067811865476 0.7071067811865476 0 0", "0.06 0 0", 1.5, 0.1, 0.01, 5.0 / 6,
     R"(<geom class="trim" type="cylinder" size="0.045 0.06"/>
        <geom class="shell" type="capsule" size="0.045" fromto="0.02 0 0 0.088 0 0"/>
        <geom class="collision" type="capsule" size="0.05" fromto="0 0 0 0.088 0 0"/>)"},
    {"0.088 0 0", "0.7071067811865476 0.7071067811865476 0 0", "0 0 0.08", 0.5, 0.05, 0.01, 5.0 / 7,
     R"(<geom class="shell" type="cylinder" size="0.044 0.035" pos="0 0 0.06"/>
        <geom class="trim" type="cylinder" size="0.04 0.006" pos="0 0 0.1"/>
        <geom class="collision" type="capsule" size="0.045" fromto="0 0 0.02 0 0 0.06"/>)"},
}};

// Hand, fingers, tool site and wrist camera, in the flange frame. Pads: 16 x 8 x 16 mm,
// centred 93.4 mm from the hand's origin; the tool site lies between them at 97 mm.
constexpr char kHandXml[] = R"(
<body name="robot0_right_hand" pos="0 0 0.1065" quat="0.924 0 0 -0.383">
  <inertial pos="0 0 0" mass="0.5" diaginertia="0.05 0.05 0.05"/>
  <camera name="robot0_eye_in_hand" mode="fixed" pos="0.05 0 0" quat="0 0.70710678 0.70710678 0" fovy="75"/>
  <body name="gripper0_right_gripper" quat="0.7071067811865476 0 0 -0.7071067811865476">
    <inertial pos="0 0 0.17" quat="0.7071067811865476 0.7071067811865476 0 0" mass="0.3" diaginertia="0.09 0.07 0.05"/>
    <geom class="shell" type="box" size="0.095 0.019 0.021" pos="0 0 0.036"/>
    <geom class="trim" type="box" size="0.085 0.015 0.005" pos="0 0 0.06"/>
    <geom class="collision" name="gripper0_hand_collision" type="box" size="0.1 0.022 0.03" pos="0 0 0.032"/>
    <body name="gripper0_eef" pos="0 0 0.097">
      <site name="gripper0_grip_site" size="0.002" group="4"/>
    </body>
    %s
  </body>
</body>)";

// One finger; side +1 is finger 1 (left), -1 is finger 2 (right). Both slide along the y axis of
// robot0_right_hand, the hand's long side.
// `joint` lets it slide, else it stands half open.
std::string FingerXml(int side, bool joint) {
  const int index = side > 0 ? 1 : 2;
  const std::string slide = absl::StrFormat(
      R"(<joint name="gripper0_finger_joint%d" type="slide" axis="0 1 0" limited="true" range="%g %g" damping="100"
             armature="1" frictionloss="1"/>)",
      index, side > 0 ? 0.0 : -0.04, side > 0 ? 0.04 : 0.0);
  // The body's y axis is the hand's -x.
  const double x = joint ? 0 : -side * PandaHomeFingers()[0];
  return absl::StrFormat(
      R"(
    <body name="gripper0_%sfinger" pos="%s 0 0.0524" quat="0.7071067811865476 0 0 0.7071067811865476">
      <inertial pos="0 0 0.05" mass="0.1" diaginertia="0.01 0.01 0.005"/>
      %s
      <geom class="trim" type="box" size="0.0095 0.008 0.012" pos="0 %g 0.012"/>
      <geom class="finger" type="box" size="0.0085 0.0055 0.019" pos="0 %g 0.035"/>
      <geom class="collision" name="gripper0_finger%d_collision" type="box" size="0.0095 0.0065 0.0125"
            pos="0 %g 0.02" friction="1 0.005 0.0001"/>
      <body name="gripper0_finger_joint%d_tip" pos="0 %g 0.056">
        <inertial pos="0 0 0" mass="0.01" diaginertia="0.01 0.01 0.01"/>
        <geom class="collision" name="gripper0_finger%d_pad_collision" type="box" size="0.008 0.004 0.008"
              pos="0 %g -0.015" friction="2 0.05 0.0001" condim="4" solref="0.01 0.5"/>
      </body>
    </body>)",
      side > 0 ? "left" : "right", absl::StrCat(x), joint ? slide : std::string(), side * 0.008,
      side * 0.0055, index, side * 0.0085, index, side * 0.0085, index, side * -0.005);
}

std::string ArmXml(bool fingers_slide) {
  std::string open, close;
  for (size_t i = 0; i < kLinks.size(); ++i) {
    const Link& link = kLinks[i];
    absl::StrAppendFormat(&open,
                          "<body name=\"robot0_link%d\" pos=\"%s\" quat=\"%s\">\n"
                          "<inertial pos=\"%s\" mass=\"%g\" diaginertia=\"%g %g %g\"/>\n",
                          i, link.pos, link.quat, link.com, link.mass, link.inertia, link.inertia,
                          link.inertia);
    if (i > 0) {
      absl::StrAppendFormat(
          &open,
          "<joint name=\"robot0_joint%d\" type=\"hinge\" axis=\"0 0 1\" limited=\"true\" "
          "range=\"%.17g %.17g\" damping=\"%.17g\" armature=\"%.17g\" frictionloss=\"0.1\"/>\n",
          i, kPanda.joints[i - 1].lower, kPanda.joints[i - 1].upper, link.damping, link.armature);
    }
    absl::StrAppend(&open, link.shape_xml, "\n");
    absl::StrAppend(&close, "</body>");
  }
  return absl::StrCat(open,
                      absl::StrFormat(kHandXml, absl::StrCat(FingerXml(1, fingers_slide),
                                                             FingerXml(-1, fingers_slide))),
                      close);
}

std::string ActuatorXml() {
  std::string xml;
  for (size_t i = 1; i < kLinks.size(); ++i) {
    const double limit = kPanda.joints[i - 1].torque_limit;
    absl::StrAppendFormat(
        &xml,
        "<motor name=\"robot0_torq_j%d\" joint=\"robot0_joint%d\" ctrllimited=\"true\" "
        "ctrlrange=\"%g %g\"/>\n",
        i, i, -limit, limit);
  }
  absl::StrAppend(&xml, R"(
<position name="gripper0_gripper_finger_joint1" joint="gripper0_finger_joint1" kp="1000" ctrllimited="true"
          ctrlrange="0 0.04" forcelimited="true" forcerange="-20 20"/>
<position name="gripper0_gripper_finger_joint2" joint="gripper0_finger_joint2" kp="1000" ctrllimited="true"
          ctrlrange="-0.04 0" forcelimited="true" forcerange="-20 20"/>)");
  return xml;
}

constexpr char kSceneFormat[] = R"(<mujoco model="%s">
<compiler angle="radian"/>
<option timestep="0.002" integrator="Euler" solver="Newton" jacobian="sparse" cone="%s" impratio="%g" iterations="%d"
        tolerance="%g" density="%g" viscosity="%g"/>
<size nconmax="%d" njmax="%d"/>
<visual>
  <map znear="0.001" shadowscale="0.5"/>
  <headlight ambient="0.35 0.35 0.35" diffuse="0.4 0.4 0.4" specular="0.1 0.1 0.1"/>
</visual>
<asset>
  <material name="panda_shell" rgba="0.93 0.93 0.91 1" specular="0.4" shininess="0.5"/>
  <material name="panda_trim" rgba="0.22 0.23 0.25 1" specular="0.3" shininess="0.3"/>
  <material name="panda_finger" rgba="0.45 0.47 0.5 1" specular="0.4" shininess="0.4"/>
  %s
</asset>
<default>
  <geom group="1"/>
  <default class="visual"><geom group="1" contype="0" conaffinity="0"/></default>
  <default class="collision">
    <geom group="0" contype="0" conaffinity="1" rgba="0.8 0.3 0.3 0.5"/>
  </default>
  <default class="shell"><geom group="1" contype="0" conaffinity="0" mass="0" material="panda_shell"/></default>
  <default class="trim"><geom group="1" contype="0" conaffinity="0" mass="0" material="panda_trim"/></default>
  <default class="finger"><geom group="1" contype="0" conaffinity="0" mass="0" material="panda_finger"/></default>
  %s
</default>
<worldbody>
  <body name="robot0_base" pos="%.17g %.17g %.17g">
    %s
  </body>
  %s
</worldbody>
<contact>%s</contact>
<actuator>%s</actuator>
</mujoco>
)";

constexpr char kArmFormat[] = R"(<mujoco model="panda_arm">
<compiler angle="radian"/>
<option timestep="0.002" integrator="Euler"/>
<default>
  <default class="collision"><geom contype="0" conaffinity="0"/></default>
  <default class="shell"><geom contype="0" conaffinity="0" mass="0"/></default>
  <default class="trim"><geom contype="0" conaffinity="0" mass="0"/></default>
  <default class="finger"><geom contype="0" conaffinity="0" mass="0"/></default>
</default>
<worldbody>
  <body name="robot0_base">
    %s
  </body>
</worldbody>
</mujoco>
)";

}  // namespace

std::string ComposePandaScene(const PandaScene& scene) {
  const Eigen::Vector3d& p = scene.base_position;
  return absl::StrFormat(kSceneFormat, scene.name, scene.elliptic_cone ? "elliptic" : "pyramidal",
                         scene.impratio, scene.iterations, scene.tolerance, scene.density,
                         scene.viscosity, scene.max_contacts, scene.max_constraints,
                         scene.assets_xml, scene.defaults_xml, p.x(), p.y(), p.z(), ArmXml(true),
                         scene.world_xml, scene.contact_xml, ActuatorXml());
}

std::string ComposePandaArm() { return absl::StrFormat(kArmFormat, ArmXml(false)); }

Eigen::Matrix<double, 7, 1> PandaHome() {
  Eigen::Matrix<double, 7, 1> q;
  q << 0, -0.16103738945, 0, -2.44459747, 0, 2.2267522, 0.7853981633974483;
  return q;
}

Eigen::Vector2d PandaHomeFingers() { return {0.020833, -0.020833}; }

}  // namespace robostress
