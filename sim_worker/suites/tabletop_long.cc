#include "sim_worker/suites/scene_spec.h"

namespace robostress {

// Two goals in a row, in two scenes.
SuiteSpec TabletopLong() {
  SuiteSpec suite;
  suite.name = "tabletop_long";
  SceneSpec packing;
  packing.props = {
      {"basket", PropKind::kBasket, "brown", "", {0.53, -0.21}, {0.03, 0.02}},
      {"plate", PropKind::kPlate, "white", "", {0.53, 0.22}, {0.03, 0.03}},
      {"cube", PropKind::kCube, "red", "", {0.43, 0.04}, {0.03, 0.03}},
      {"can", PropKind::kCan, "blue", "", {0.65, 0.05}, {0.03, 0.03}},
      {"bottle", PropKind::kBottle, "yellow", "", {0.53, -0.04}, {0.025, 0.03}},
  };
  SceneSpec kitchen;
  kitchen.props = {
      {"cabinet", PropKind::kCabinet, "brown", "", {0.65, 0.25}, {0.03, 0.015}},
      {"stove", PropKind::kStove, "grey", "", {0.65, -0.25}, {0.02, 0.02}},
      {"plate", PropKind::kPlate, "white", "", {0.48, -0.18}, {0.02, 0.03}},
      {"pot", PropKind::kPot, "red", "", {0.42, 0.17}, {0.03, 0.03}},
      {"cube", PropKind::kCube, "green", "", {0.45, 0.01}, {0.035, 0.035}},
  };
  suite.scenes = {packing, kitchen};
  const Eigen::Vector2d near = {-0.034, 0}, far = {0.034, 0};
  suite.tasks = {
      {"put the red cube and the blue can in the basket",
       0,
       {{GoalKind::kPlace, "cube", "basket", near}, {GoalKind::kPlace, "can", "basket", far}}},
      {"put the red cube and the yellow bottle in the basket",
       0,
       {{GoalKind::kPlace, "cube", "basket", near}, {GoalKind::kPlace, "bottle", "basket", far}}},
      {"put the blue can and the yellow bottle in the basket",
       0,
       {{GoalKind::kPlace, "can", "basket", far}, {GoalKind::kPlace, "bottle", "basket", near}}},
      {"put the red cube in the basket and the blue can on the plate",
       0,
       {{GoalKind::kPlace, "cube", "basket"}, {GoalKind::kPlace, "can", "plate"}}},
      {"put the yellow bottle in the basket and the red cube on the plate",
       0,
       {{GoalKind::kPlace, "bottle", "basket"}, {GoalKind::kPlace, "cube", "plate"}}},
      {"open the drawer and put the green cube in it",
       1,
       {{GoalKind::kOpen, "cabinet", ""}, {GoalKind::kPlace, "cube", "cabinet/drawer"}}},
      {"turn on the stove and put the red pot on it",
       1,
       {{GoalKind::kTurnOn, "stove", ""}, {GoalKind::kPlace, "pot", "stove"}}},
      {"put the red pot on the stove and the green cube on the plate",
       1,
       {{GoalKind::kPlace, "pot", "stove"}, {GoalKind::kPlace, "cube", "plate"}}},
      {"open the drawer and put the red pot on the plate",
       1,
       {{GoalKind::kOpen, "cabinet", ""}, {GoalKind::kPlace, "pot", "plate"}}},
      {"turn on the stove and put the green cube on the plate",
       1,
       {{GoalKind::kTurnOn, "stove", ""}, {GoalKind::kPlace, "cube", "plate"}}},
  };
  return suite;
}

}  // namespace robostress
