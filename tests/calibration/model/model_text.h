#pragma once

#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_replace.h"
#include "calibration/model/model_file.h"
#include "calibration/model/plant.h"
#include "common/atomic_file.h"

namespace robostress::calibration {

// A rig of joints that are driven to targets, on a model that is given as text.
struct ModelText : public testing::Test {
  ~ModelText() override { std::filesystem::remove_all(folder); }

  Rig RigOf(const std::string& text, const std::vector<std::string>& joints,
            const std::string& name = "arm.model") const {
    EXPECT_TRUE(MakeDirectories(folder).ok());
    Rig rig;
    rig.file = folder + "/rig.yaml";
    rig.model = folder + "/" + name;
    std::ofstream(rig.model, std::ios::binary) << text;
    for (const std::string& joint : joints) {
      rig.joints.emplace_back().name = joint;
      rig.joints.back().servo.kp = 1;
    }
    return rig;
  }
  absl::StatusOr<LoadedModel> Load(const std::string& text,
                                   const std::vector<std::string>& joints) {
    return LoadModel(RigOf(text, joints));
  }
  // What Plant says of a text that it refuses.
  std::string Refusal(const std::string& text, const std::vector<std::string>& joints) const {
    const auto plant = Plant::Load(RigOf(text, joints));
    return plant.ok() ? "it was accepted" : std::string(plant.status().message());
  }

  const std::string folder = (std::filesystem::path(testing::TempDir()) /
                              testing::UnitTest::GetInstance()->current_test_info()->name())
                                 .string();
};

// A shoulder and an elbow that hang down, and a gripper whose second finger mimics the first.
inline constexpr char kTwoLinks[] = R"(<?xml version="1.0"?>
<robot name="two">
  <link name="base"><visual><geometry><mesh filename="package://no/such.dae"/></geometry></visual></link>
  <link name="upper">
    <inertial><origin xyz="0 0 -0.2"/><mass value="2"/>
      <inertia ixx="0.03" iyy="0.03" izz="0.002" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="lower">
    <inertial><origin xyz="0 0 -0.1" rpy="0.3 0 0"/><mass value="1"/>
      <inertia ixx="0.01" iyy="0.01" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
  </link>
  <link name="left"><inertial><mass value="0.02"/></inertial></link>
  <link name="right"><inertial><mass value="0.02"/></inertial></link>
  <joint name="shoulder" type="revolute">
    <parent link="base"/><child link="upper"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="20" velocity="1"/><dynamics damping="0.5" friction="0.1"/>
  </joint>
  <joint name="elbow" type="continuous">
    <origin xyz="0 0 -0.4"/><parent link="upper"/><child link="lower"/><axis xyz="0 1 0"/>
  </joint>
  <joint name="finger" type="prismatic">
    <origin xyz="0 0 -0.2"/><parent link="lower"/><child link="left"/><axis xyz="1 0 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="1"/>
  </joint>
  <joint name="finger_2" type="prismatic">
    <origin xyz="0 0 -0.2"/><parent link="lower"/><child link="right"/><axis xyz="-1 0 0"/>
    <limit lower="0" upper="0.04" effort="5" velocity="1"/><mimic joint="finger" multiplier="1"/>
  </joint>
</robot>
)";

inline std::string With(const std::string& from, const std::string& to,
                        std::string text = kTwoLinks) {
  EXPECT_NE(text.find(from), std::string::npos) << from;
  return absl::StrReplaceAll(text, {{from, to}});
}

}  // namespace robostress::calibration
