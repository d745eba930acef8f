#pragma once

#include <string>

namespace robostress::piper {

// A scene around our own MJCF of the Piper with its 70 mm gripper. Kinematics are the SDK's
// (kinematics.h, zeros since S-V1.6-3), masses and inertias those of the vendor's robot description
// of 2025; shapes are ours: capsules and boxes. Names: piper_base, piper_link1..6, piper_joint1..6,
// piper_finger1/2 (slides, 0 closed to 0.035 m), piper_tool (site, the SDK's tool frame),
// piper_grip (site between the finger tips), piper_payload (body), cameras piper_base_view and
// piper_wrist_view. Joints have no friction and no actuators: what a motor gives and what resists
// it is applied by PiperPlant.
//
// Contacts: shapes of the arm touch what has bit 1 in its contype (the MJCF default), never each
// other.
struct PiperScene {
  std::string name = "piper";
  std::string assets_xml;  // children of `<asset>`
  std::string world_xml;   // children of `<worldbody>` beside the arm, its floor and a light
  double payload_kg = 0;   // held between the finger tips, part of the gripper
};
std::string ComposePiperScene(const PiperScene& scene);

}  // namespace robostress::piper
