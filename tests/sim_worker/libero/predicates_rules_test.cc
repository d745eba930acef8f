// The predicates' bounds in a scene of boxes, where LIBERO's own files are not needed.
#include <gtest/gtest.h>

#include <algorithm>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "sim_worker/libero/catalog.h"
#include "sim_worker/libero/predicates.h"

namespace robostress::libero {
namespace {

constexpr char kBoxes[] = R"(<mujoco><worldbody>
  <body name="plate"><geom name="plate" type="box" size="0.2 0.2 0.02"/>
    <site name="basket" pos="0 0 0.1" size="0.05 0.05 0.05"/></body>
  <body name="cup" pos="0 0 0.5"><freejoint/><geom name="cup" type="box" size="0.02 0.02 0.02"/></body>
  <body name="cabinet" pos="2 0 0">
    <body><joint name="top" type="slide" axis="0 1 0"/><geom size="0.01"/></body>
    <body pos="0 0 1"><joint name="bottom" type="slide" axis="0 1 0"/><geom size="0.01"/></body></body>
</worldbody></mujoco>)";

constexpr Articulation kCabinet = {
    .category = "cabinet", .open_range = {-0.16, -0.14}, .close_range = {0.0, 0.005}};

class PredicateRules : public testing::Test {
 protected:
  void SetUp() override {
    auto model = CompileModel("boxes", kBoxes);
    ASSERT_TRUE(model.ok()) << model.status();
    scene_.model = *model;
    data_.reset(mj_makeData(model_()));
    for (const char* name : {"plate", "cup", "cabinet"}) {
      LiberoObject object;
      object.name = name;
      object.body = mj_name2id(model_(), mjOBJ_BODY, name);
      object.contact_geom.assign(model_()->ngeom, 0);
      const int geom = mj_name2id(model_(), mjOBJ_GEOM, name);
      if (geom >= 0) object.contact_geom[geom] = 1;
      scene_.objects[name] = object;
    }
    LiberoObject& cabinet = scene_.objects.at("cabinet");
    cabinet.articulation = &kCabinet;
    for (const char* joint : {"top", "bottom"})
      cabinet.joints.push_back(mj_name2id(model_(), mjOBJ_JOINT, joint));
    LiberoSite basket;
    basket.name = "basket";
    basket.parent = "plate";
    basket.site = mj_name2id(model_(), mjOBJ_SITE, "basket");
    scene_.sites["basket"] = basket;
    scene_.problem.file = "boxes.bddl";
  }

  const mjModel* model_() const { return scene_.model.get(); }
  bool Holds(const std::string& predicate, std::vector<std::string> arguments) {
    scene_.problem.goal = {{predicate, std::move(arguments), 1}};
    const auto goal = LiberoGoal::Create(scene_);
    EXPECT_TRUE(goal.ok()) << goal.status();
    mj_forward(model_(), data_.get());
    return goal->Holds(*data_);
  }
  void PutCup(double x, double y, double z) {
    const double pose[7] = {x, y, z, 1, 0, 0, 0};
    std::copy(pose, pose + 7, data_->qpos);
  }
  // The cup's seven coordinates come first.
  void Pull(double top, double bottom) {
    data_->qpos[7] = top;
    data_->qpos[8] = bottom;
  }

  struct Free {
    void operator()(mjData* data) const { mj_deleteData(data); }
  };
  LiberoScene scene_;
  std::unique_ptr<mjData, Free> data_;
};

TEST_F(PredicateRules, OnAnObjectIsContactFromAboveWithinThreeCentimetres) {
  for (const double off : {0.0, 0.029, 0.031, 0.1}) {
    PutCup(off, 0, 0.0395);
    EXPECT_EQ(Holds("on", {"cup", "plate"}), off < 0.03) << off;
  }
  PutCup(0, 0, 0.045);
  EXPECT_FALSE(Holds("on", {"cup", "plate"})) << "no contact";
  PutCup(0, 0, -0.0395);
  EXPECT_FALSE(Holds("on", {"cup", "plate"})) << "below";
}

TEST_F(PredicateRules, InIsTheBoxWithACentimetreBelow) {
  for (const double z : {0.03, 0.039, 0.041, 0.1, 0.149, 0.151}) {
    PutCup(0, 0, z);
    EXPECT_EQ(Holds("in", {"cup", "basket"}), z > 0.04 && z < 0.15) << z;
  }
  for (const double x : {0.049, 0.051}) {
    PutCup(x, 0, 0.1);
    EXPECT_EQ(Holds("in", {"cup", "basket"}), x < 0.05) << x;
  }
}

TEST_F(PredicateRules, OpenIsOneDrawerAndClosedAreAll) {
  Pull(-0.15, 0);
  EXPECT_TRUE(Holds("open", {"cabinet"}));
  EXPECT_FALSE(Holds("close", {"cabinet"}));
  Pull(-0.13, -0.13);
  EXPECT_FALSE(Holds("open", {"cabinet"}));
  Pull(0.001, 0.001);
  EXPECT_TRUE(Holds("close", {"cabinet"}));
  Pull(0.001, -0.001);
  EXPECT_FALSE(Holds("close", {"cabinet"}));
}

}  // namespace
}  // namespace robostress::libero
