#pragma once

#include <gtest/gtest.h>

#include <memory>
#include <vector>

#include "sim_worker/panda_mjcf.h"
#include "sim_worker/panda_sim.h"

namespace robostress {

// A table with a cube between the fingers' reach, the base at the table's edge.
inline PandaScene TestScene() {
  PandaScene scene;
  scene.name = "test";
  scene.base_position = {0, 0, 0};
  scene.world_xml = R"(
    <light pos="0.5 0 2" dir="0 0 -1" directional="true"/>
    <camera name="agentview" pos="1.6 0 0.9" xyaxes="0 1 0 -0.5 0 0.85" fovy="45"/>
    <geom name="floor" type="plane" size="2 2 0.1" pos="0 0 -0.4" rgba="0.6 0.6 0.6 1" contype="0" conaffinity="0"/>
    <body name="table" pos="0.55 0 -0.02"><geom name="table" type="box" size="0.35 0.5 0.02" rgba="0.7 0.55 0.4 1"/></body>
    <body name="cube" pos="0.5 0 0.025"><freejoint name="cube_joint"/>
      <geom name="cube" type="box" size="0.02 0.02 0.025" mass="0.1" rgba="0.8 0.2 0.2 1" friction="0.95 0.3 0.1"/></body>)";
  return scene;
}

inline std::unique_ptr<PandaSim> MakeTestSim(const SimOptions& options = {},
                                             const PandaScene& scene = TestScene()) {
  auto model = CompileModel("test scene", ComposePandaScene(scene));
  if (!model.ok()) {
    ADD_FAILURE() << model.status();
    return nullptr;
  }
  auto sim = PandaSim::Create(*model, options);
  if (!sim.ok()) {
    ADD_FAILURE() << sim.status();
    return nullptr;
  }
  return std::move(*sim);
}

// Positions of the home posture with every other joint where the scene puts it.
inline std::vector<double> HomeState(const PandaSim& sim) {
  const mjModel& m = sim.model();
  std::vector<double> qpos(m.qpos0, m.qpos0 + m.nq);
  const auto home = PandaHome();
  std::copy(home.data(), home.data() + 7, qpos.begin());
  qpos[7] = PandaHomeFingers()[0];
  qpos[8] = PandaHomeFingers()[1];
  return qpos;
}

inline void UseScenario(PandaSim& sim, const std::string& name, int level = 5, int horizon = 220) {
  const auto scenario = MakeScenario(name, level);
  ASSERT_TRUE(scenario.ok()) << scenario.status();
  sim.SetScenario(*scenario, horizon);
}

inline Eigen::VectorXf Command(double x, double y, double z, double gripper = -1) {
  Eigen::VectorXf command = Eigen::VectorXf::Zero(7);
  command << static_cast<float>(x), static_cast<float>(y), static_cast<float>(z), 0, 0, 0,
      static_cast<float>(gripper);
  return command;
}

}  // namespace robostress
