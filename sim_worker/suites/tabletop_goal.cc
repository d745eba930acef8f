#include "sim_worker/suites/scene_spec.h"

namespace robostress {

// One scene, ten goals.
SuiteSpec TabletopGoal() {
  SuiteSpec suite;
  suite.name = "tabletop_goal";
  SceneSpec scene;
  scene.props = {
      {"cabinet", PropKind::kCabinet, "brown", "", {0.65, 0.25}, {0.03, 0.015}},
      {"stove", PropKind::kStove, "grey", "", {0.65, -0.25}, {0.02, 0.02}},
      {"rack", PropKind::kRack, "purple", "", {0.43, 0.25}, {0.02, 0.02}},
      {"mat", PropKind::kMat, "cyan", "", {0.47, -0.22}, {0.015, 0.015}},
      {"plate", PropKind::kPlate, "white", "", {0.48, -0.02}, {0.02, 0.025}},
      {"pot", PropKind::kPot, "red", "", {0.405, 0.11}, {0.025, 0.03}},
      {"cube", PropKind::kCube, "yellow", "", {0.63, -0.03}, {0.03, 0.025}},
      {"bottle", PropKind::kBottle, "green", "", {0.55, 0.10}, {0.02, 0.03}},
  };
  suite.scenes = {scene};
  suite.tasks = {
      {"open the drawer of the cabinet", 0, {{GoalKind::kOpen, "cabinet", ""}}},
      {"put the pot on the plate", 0, {{GoalKind::kPlace, "pot", "plate"}}},
      {"put the pot on top of the cabinet", 0, {{GoalKind::kPlace, "pot", "cabinet"}}},
      {"put the bottle on the rack", 0, {{GoalKind::kPlace, "bottle", "rack"}}},
      {"turn on the stove", 0, {{GoalKind::kTurnOn, "stove", ""}}},
      {"push the plate onto the mat", 0, {{GoalKind::kPush, "plate", "mat"}}},
      {"put the cube on the plate", 0, {{GoalKind::kPlace, "cube", "plate"}}},
      {"put the pot on the stove", 0, {{GoalKind::kPlace, "pot", "stove"}}},
      {"put the cube on the rack", 0, {{GoalKind::kPlace, "cube", "rack"}}},
      {"put the bottle on top of the cabinet", 0, {{GoalKind::kPlace, "bottle", "cabinet"}}},
  };
  return suite;
}

}  // namespace robostress
