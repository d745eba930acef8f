#include "sim_worker/suites/scene_spec.h"

namespace robostress {
namespace {

// Where a pot may stand, and how the instruction says so.
struct Relation {
  const char* phrase;
  const char* anchor;
  Eigen::Vector2d offset, jitter;  // from the anchor [m]
  bool on_anchor;
};

const Relation kRelations[] = {
    {"next to the plate", "plate", {0.0, 0.14}, {0.025, 0.015}, false},
    {"on the mat", "mat", {0.0, 0.0}, {0.025, 0.025}, true},
    {"on the box", "box", {0.0, 0.0}, {0.015, 0.015}, true},
    {"next to the cup", "cup", {0.0, 0.10}, {0.02, 0.015}, false},
    {"in front of the cabinet", "cabinet", {-0.14, 0.0}, {0.02, 0.02}, false},
    {"between the plate and the mat", "plate", {0.075, -0.125}, {0.02, 0.015}, false},
    {"on the cabinet", "cabinet", {0.0, 0.0}, {0.02, 0.02}, true},
    {"in front of the plate", "plate", {-0.135, 0.0}, {0.01, 0.03}, false},
    {"behind the plate", "plate", {0.14, 0.0}, {0.015, 0.03}, false},
    {"next to the box", "box", {0.0, -0.12}, {0.02, 0.015}, false},
};

}  // namespace

// Two pots that look the same: only their place among the landmarks tells which one is meant. Every
// scene holds the pots of two relations, so a scene alone does not decide the task.
SuiteSpec TabletopSpatial() {
  SuiteSpec suite;
  suite.name = "tabletop_spatial";
  for (int pair = 0; pair < 5; ++pair) {
    SceneSpec scene;
    scene.props = {
        {"plate", PropKind::kPlate, "white", "", {0.52, -0.02}, {0.025, 0.025}},
        {"box", PropKind::kBox, "blue", "", {0.425, 0.215}, {0.02, 0.02}},
        {"cabinet", PropKind::kCabinet, "brown", "", {0.67, 0.235}, {0.02, 0.02}},
        {"mat", PropKind::kMat, "yellow", "", {0.65, -0.25}, {0.02, 0.02}},
        {"cup", PropKind::kCup, "green", "", {0.42, -0.235}, {0.02, 0.02}},
    };
    for (int i = 2 * pair; i < 2 * pair + 2; ++i) {
      const Relation& relation = kRelations[i];
      const std::string pot = i % 2 == 0 ? "pot_a" : "pot_b";
      scene.props.push_back({pot, PropKind::kPot, "red", relation.anchor, relation.offset,
                             relation.jitter, relation.on_anchor});
      suite.tasks.push_back(
          {std::string("pick up the red pot ") + relation.phrase + " and place it on the plate",
           pair,
           {{GoalKind::kPlace, pot, "plate"}}});
    }
    suite.scenes.push_back(scene);
  }
  return suite;
}

}  // namespace robostress
