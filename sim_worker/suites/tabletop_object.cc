#include "sim_worker/suites/scene_spec.h"

namespace robostress {
namespace {

struct Item {
  const char* color;
  const char* noun;
  PropKind kind;
};

const Item kItems[2][5] = {
    {{"red", "cube", PropKind::kCube},
     {"blue", "can", PropKind::kCan},
     {"yellow", "bottle", PropKind::kBottle},
     {"green", "brick", PropKind::kBrick},
     {"purple", "pot", PropKind::kPot}},
    {{"orange", "can", PropKind::kCan},
     {"cyan", "cube", PropKind::kCube},
     {"pink", "brick", PropKind::kBrick},
     {"black", "pot", PropKind::kPot},
     {"white", "bottle", PropKind::kBottle}},
};
const Eigen::Vector2d kPlaces[5] = {
    {0.43, 0.24}, {0.64, 0.24}, {0.535, 0.135}, {0.43, 0.03}, {0.64, 0.03}};

}  // namespace

// Five things and a basket; the instruction names the thing.
SuiteSpec TabletopObject() {
  SuiteSpec suite;
  suite.name = "tabletop_object";
  for (int s = 0; s < 2; ++s) {
    SceneSpec scene;
    scene.props = {{"basket", PropKind::kBasket, "brown", "", {0.53, -0.20}, {0.04, 0.03}}};
    for (int i = 0; i < 5; ++i) {
      const Item& item = kItems[s][i];
      const std::string name = std::string(item.color) + "_" + item.noun;
      scene.props.push_back({name, item.kind, item.color, "", kPlaces[i], {0.035, 0.035}});
      suite.tasks.push_back({std::string("pick up the ") + item.color + " " + item.noun +
                                 " and place it in the basket",
                             s,
                             {{GoalKind::kPlace, name, "basket"}}});
    }
    suite.scenes.push_back(scene);
  }
  return suite;
}

}  // namespace robostress
