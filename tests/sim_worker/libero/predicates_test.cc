// Goal predicates, true and false, by placing the objects of LIBERO's own scenes.
#include "sim_worker/libero/predicates.h"

#include <gmock/gmock.h>

#include <cmath>
#include <numbers>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "tests/common/libero/shared_data.h"

namespace robostress::libero {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// A composed scene whose objects can be put anywhere.
class PredicatesTest : public ::testing::Test {
 protected:
  void Compose(const std::string& suite, const std::string& task) {
    const absl::StatusOr<LiberoPaths> paths = FindLibero(LiberoTree(), RobosuiteTree());
    ASSERT_TRUE(paths.ok()) << paths.status();
    absl::StatusOr<BddlProblem> problem =
        ReadBddl(absl::StrCat(paths->libero, "/bddl_files/", suite, "/", task, ".bddl"));
    ASSERT_TRUE(problem.ok()) << problem.status();
    absl::StatusOr<LiberoScene> scene = ComposeScene(*paths, *std::move(problem));
    ASSERT_TRUE(scene.ok()) << scene.status();
    scene_ = std::make_unique<LiberoScene>(*std::move(scene));
    ASSERT_NO_FATAL_FAILURE(PlaceWith({}));
  }

  // Fixtures at the centres of their regions but for `moved`, every object far from every other.
  void PlaceWith(const std::vector<FixturePose>& moved) {
    std::vector<FixturePose> poses = scene_->centred_fixtures;
    poses.insert(poses.end(), moved.begin(), moved.end());
    const absl::StatusOr<SharedModel> model = PlaceFixtures(*scene_, poses);
    ASSERT_TRUE(model.ok()) << model.status();
    model_ = *model;
    data_.reset(mj_makeData(model_.get()));
    double y = 3;
    for (const auto& [name, object] : scene_->objects) {
      if (!object.fixture) Put(name, {3, y += 0.5, 2});
    }
    Forward();
  }

  void Put(const std::string& object, const Eigen::Vector3d& p) {
    const int address = model_->jnt_qposadr[scene_->objects.at(object).joints.back()];
    const double pose[7] = {p.x(), p.y(), p.z(), 1, 0, 0, 0};
    std::copy(pose, pose + 7, data_->qpos + address);
  }
  // The fixture turned about the vertical axis, where it stands.
  FixturePose Turned(const std::string& fixture, double yaw) const {
    const Eigen::Vector3d p = Body(fixture);
    return {fixture, {p.x(), p.y(), p.z()}, {std::cos(yaw / 2), 0, 0, std::sin(yaw / 2)}};
  }
  bool HoldsWith(const std::string& joint, double q, const std::string& predicate,
                 const std::string& target) {
    SetJoint(joint, q);
    return Holds(predicate, {target});
  }
  bool HoldsAt(const Eigen::Vector3d& p, const std::string& predicate, const std::string& object,
               const std::string& target) {
    Put(object, p);
    Forward();
    return Holds(predicate, {object, target});
  }
  void SetJoint(const std::string& joint, double q) {
    data_->qpos[model_->jnt_qposadr[mj_name2id(model_.get(), mjOBJ_JOINT, joint.c_str())]] = q;
  }
  void Forward() { mj_forward(model_.get(), data_.get()); }
  Eigen::Vector3d Site(const std::string& name) const {
    return Eigen::Map<const Eigen::Vector3d>(
        data_->site_xpos + 3 * mj_name2id(model_.get(), mjOBJ_SITE, name.c_str()));
  }
  Eigen::Vector3d Body(const std::string& name) const {
    return Eigen::Map<const Eigen::Vector3d>(data_->xpos + 3 * scene_->objects.at(name).body);
  }

  absl::StatusOr<bool> TryHolds(const std::string& predicate,
                                const std::vector<std::string>& arguments) {
    scene_->problem.goal = {BddlAtom{predicate, arguments, 7}};
    const absl::StatusOr<LiberoGoal> goal = LiberoGoal::Create(*scene_);
    if (!goal.ok()) return goal.status();
    return goal->Holds(*data_);
  }
  bool Holds(const std::string& predicate, const std::vector<std::string>& arguments) {
    const absl::StatusOr<bool> holds = TryHolds(predicate, arguments);
    EXPECT_TRUE(holds.ok()) << holds.status();
    return holds.ok() && *holds;
  }
  std::string ErrorOf(const std::string& predicate, const std::vector<std::string>& arguments) {
    const absl::StatusOr<bool> holds = TryHolds(predicate, arguments);
    return holds.ok() ? "resolved" : std::string(holds.status().message());
  }

  struct Delete {
    void operator()(mjData* data) const { mj_deleteData(data); }
  };
  std::unique_ptr<LiberoScene> scene_;
  SharedModel model_;
  std::unique_ptr<mjData, Delete> data_;
};

TEST_F(PredicatesTest, KitchenCounterOfTheGoalSuite) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose("libero_goal", "put_the_bowl_on_the_plate"));
  const std::string bowl = "akita_black_bowl_1", plate = "plate_1";

  // On an object: contact, above, and within 3 cm.
  Put(plate, {0.1, 0.2, 0.902});
  Put(bowl, {0.1, 0.2, 0.905});
  Forward();
  EXPECT_TRUE(Holds("on", {bowl, plate}));
  EXPECT_FALSE(Holds("on", {plate, bowl})) << "the order of the arguments matters";
  Put(bowl, {0.1, 0.231, 0.905});
  Forward();
  EXPECT_FALSE(Holds("on", {bowl, plate})) << "31 mm beside";
  Put(bowl, {0.1, 0.2, 1.0});
  Forward();
  EXPECT_FALSE(Holds("on", {bowl, plate})) << "no contact";
  Put(bowl, {0.1, 0.2, 0.9015});
  Forward();
  EXPECT_FALSE(Holds("on", {bowl, plate})) << "its origin is below the plate's";

  // On a zone of the table: no contact needed, a band of height.
  const Eigen::Vector3d zone = Site("main_table_stove_front_region");
  Put(plate, zone + Eigen::Vector3d(0.03, 0.03, 0.0075));
  Forward();
  EXPECT_TRUE(Holds("on", {plate, "main_table_stove_front_region"}));
  Put(plate, zone + Eigen::Vector3d(0.041, 0.03, 0.0075));
  Forward();
  EXPECT_FALSE(Holds("on", {plate, "main_table_stove_front_region"})) << "beside the zone";
  Put(plate, zone + Eigen::Vector3d(0, 0, 0.108));
  Forward();
  EXPECT_FALSE(Holds("on", {plate, "main_table_stove_front_region"})) << "too high";
  Put(plate, zone + Eigen::Vector3d(0, 0, 0.001));
  Forward();
  EXPECT_FALSE(Holds("on", {plate, "main_table_stove_front_region"})) << "too low";

  // On a site of a fixture: contact with the fixture as well.
  const Eigen::Vector3d burner = Site("flat_stove_1_cook_region");
  Put(bowl, burner + Eigen::Vector3d(0, 0, 0.0235));
  Forward();
  EXPECT_TRUE(Holds("on", {bowl, "flat_stove_1_cook_region"}));
  Put(bowl, burner + Eigen::Vector3d(0, 0, 0.06));
  Forward();
  EXPECT_FALSE(Holds("on", {bowl, "flat_stove_1_cook_region"})) << "hovers";

  // In a drawer's region, which moves with the drawer.
  const Eigen::Vector3d drawer = Site("wooden_cabinet_1_top_region");
  Put(bowl, drawer);
  Forward();
  EXPECT_TRUE(Holds("in", {bowl, "wooden_cabinet_1_top_region"}));
  SetJoint("wooden_cabinet_1_top_level", -0.15);
  Forward();
  EXPECT_FALSE(Holds("in", {bowl, "wooden_cabinet_1_top_region"})) << "the drawer moved away";
  Put(bowl, Site("wooden_cabinet_1_top_region"));
  Forward();
  EXPECT_TRUE(Holds("in", {bowl, "wooden_cabinet_1_top_region"}));

  // Open and close: the joint that moves the site, strict thresholds.
  EXPECT_TRUE(Holds("open", {"wooden_cabinet_1_top_region"}));
  EXPECT_FALSE(Holds("open", {"wooden_cabinet_1_middle_region"}));
  EXPECT_TRUE(Holds("open", {"wooden_cabinet_1"})) << "any joint of the object";
  SetJoint("wooden_cabinet_1_top_level", -0.14);
  EXPECT_FALSE(Holds("open", {"wooden_cabinet_1_top_region"}))
      << "the threshold itself is not open";
  EXPECT_FALSE(Holds("close", {"wooden_cabinet_1_middle_region"}))
      << "0 is not closed: the originals ask q > 0";
  SetJoint("wooden_cabinet_1_middle_level", 1e-6);
  EXPECT_TRUE(Holds("close", {"wooden_cabinet_1_middle_region"}));
  EXPECT_FALSE(Holds("close", {"wooden_cabinet_1"})) << "every joint of the object";

  // The stove's knob.
  EXPECT_FALSE(Holds("turnon", {"flat_stove_1"}));
  EXPECT_FALSE(Holds("turnoff", {"flat_stove_1"})) << "0 is not below 0";
  SetJoint("flat_stove_1_button", 0.5);
  EXPECT_TRUE(Holds("turnon", {"flat_stove_1"})) << "the threshold itself is on";
  SetJoint("flat_stove_1_button", -0.001);
  EXPECT_TRUE(Holds("turnoff", {"flat_stove_1"}));

  Put(bowl, {0, 0, 1.0});
  Forward();
  EXPECT_TRUE(Holds("up", {bowl}));
  EXPECT_FALSE(Holds("up", {"wooden_cabinet_1"}));

  // Names that cannot be resolved.
  EXPECT_THAT(ErrorOf("under", {bowl, plate}),
              HasSubstr("bddl:7: predicate 'under' is unknown; known: on in open"));
  EXPECT_THAT(ErrorOf("on", {"spoon_1", plate}),
              HasSubstr("'spoon_1' is not an object or fixture"));
  EXPECT_THAT(ErrorOf("on", {bowl, "spoon_1"}),
              HasSubstr("'spoon_1' is neither an object nor a region"));
  EXPECT_THAT(ErrorOf("on", {bowl}), HasSubstr("'on' takes 2 names, got 1"));
  EXPECT_THAT(ErrorOf("in", {bowl, plate}), HasSubstr("'in' needs a region"));
  EXPECT_THAT(ErrorOf("open", {"flat_stove_1"}), HasSubstr("'flat_stove_1' cannot open"));
  EXPECT_THAT(ErrorOf("turnon", {plate}), HasSubstr("'plate_1' cannot turnon"));
  EXPECT_THAT(ErrorOf("on", {plate, plate}), HasSubstr("'plate_1' cannot be on itself"));
}

TEST_F(PredicatesTest, MicrowaveClosesAsAnObjectAndContainsInWorldAxes) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose(
      "libero_10", "KITCHEN_SCENE6_put_the_yellow_and_white_mug_in_the_microwave_and_close_it"));
  EXPECT_TRUE(Holds("close", {"microwave_1"}));
  SetJoint("microwave_1_microjoint", -0.005);
  EXPECT_FALSE(Holds("close", {"microwave_1"}));
  SetJoint("microwave_1_microjoint", -1.31);
  EXPECT_TRUE(Holds("open", {"microwave_1"}));
  const Eigen::Vector3d inside = Site("microwave_1_heating_region");
  const Eigen::Vector3d half(0.12, 0.0835, 0.08);
  for (int axis = 0; axis < 3; ++axis) {
    Eigen::Vector3d edge = Eigen::Vector3d::Zero();
    edge[axis] = half[axis];
    Put("white_yellow_mug_1", inside + 0.99 * edge);
    Forward();
    EXPECT_TRUE(Holds("in", {"white_yellow_mug_1", "microwave_1_heating_region"})) << axis;
    Put("white_yellow_mug_1", inside + 1.01 * edge);
    Forward();
    EXPECT_FALSE(Holds("in", {"white_yellow_mug_1", "microwave_1_heating_region"})) << axis;
  }
  Put("white_yellow_mug_1", inside - Eigen::Vector3d(0, 0, half.z() + 0.009));
  Forward();
  EXPECT_TRUE(Holds("in", {"white_yellow_mug_1", "microwave_1_heating_region"}))
      << "the lower bound reaches 1 cm further";
}

// LIBERO's comparison is z_target <= z_object, some contact, and a distance below 3 cm.
TEST_F(PredicatesTest, OnAnObjectAtItsThreeBounds) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose("libero_goal", "put_the_bowl_on_the_plate"));
  const std::string bowl = "akita_black_bowl_1", plate = "plate_1";
  const Eigen::Vector3d p(0.1, 0.2, 0.902);
  Put(plate, p);
  EXPECT_TRUE(HoldsAt(p, "on", bowl, plate)) << "equal heights are on";
  EXPECT_FALSE(HoldsAt(p - Eigen::Vector3d(0, 0, 1e-6), "on", bowl, plate)) << "below is not";
  const Eigen::Vector3d up(0, 0, 0.003);
  for (const double angle : {0.0, 1.0, 4.0}) {
    const Eigen::Vector3d aside(std::cos(angle), std::sin(angle), 0);
    EXPECT_TRUE(HoldsAt(p + up + 0.0299 * aside, "on", bowl, plate)) << angle;
    EXPECT_FALSE(HoldsAt(p + up + 0.0301 * aside, "on", bowl, plate)) << angle;
    EXPECT_TRUE(InContact(*data_, scene_->objects.at(bowl), scene_->objects.at(plate)))
        << "it is the distance that decides";
  }
}

// A zone has no owner: the band of height and the rectangle decide, hovering is on.
TEST_F(PredicatesTest, OnAZoneOfTheTableAtItsBounds) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose("libero_goal", "push_the_plate_to_the_front_of_the_stove"));
  const std::string plate = "plate_1", zone = "main_table_stove_front_region";
  ASSERT_TRUE(scene_->sites.at(zone).parent.empty());
  const Eigen::Vector3d centre = Site(zone);
  const double* size = model_->site_size + 3 * scene_->sites.at(zone).site;
  auto on = [&](double x, double y, double z) {
    return HoldsAt(centre + Eigen::Vector3d(x, y, z), "on", plate, zone);
  };
  EXPECT_DOUBLE_EQ(size[2], 0.007);
  EXPECT_FALSE(on(0, 0, 0.007 - 0.0051));
  EXPECT_TRUE(on(0, 0, 0.007 - 0.0049)) << "5 mm below the zone's top";
  EXPECT_TRUE(on(0, 0, 0.007 + 0.0999)) << "hovers";
  EXPECT_FALSE(on(0, 0, 0.007 + 0.1001)) << "10 cm above the zone's top";
  for (const double sign : {-1.0, 1.0}) {
    EXPECT_TRUE(on(sign * 0.999 * size[0], 0, 0.05)) << sign;
    EXPECT_FALSE(on(sign * 1.001 * size[0], 0, 0.05)) << sign;
    EXPECT_TRUE(on(0, sign * 0.999 * size[1], 0.05)) << sign;
    EXPECT_FALSE(on(0, sign * 1.001 * size[1], 0.05)) << sign;
  }
}

// A site with an owner asks for contact with the owner as well, each alone is not enough.
TEST_F(PredicatesTest, OnASiteOfAFixtureNeedsPlaceAndContact) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose("libero_goal", "put_the_bowl_on_the_stove"));
  const std::string bowl = "akita_black_bowl_1", burner = "flat_stove_1_cook_region";
  const LiberoObject &stove = scene_->objects.at("flat_stove_1"), &o = scene_->objects.at(bowl);
  const Eigen::Vector3d centre = Site(burner), touching(0, 0, 0.0235);
  EXPECT_TRUE(HoldsAt(centre + touching, "on", bowl, burner));
  EXPECT_TRUE(InContact(*data_, stove, o));
  EXPECT_FALSE(HoldsAt(centre + touching + Eigen::Vector3d(0.076, 0, 0), "on", bowl, burner))
      << "touches beside the burner (half size 7.5 cm)";
  EXPECT_TRUE(InContact(*data_, stove, o));
  EXPECT_FALSE(HoldsAt(centre + Eigen::Vector3d(0, 0, 0.06), "on", bowl, burner))
      << "in the band without contact";
  EXPECT_FALSE(InContact(*data_, stove, o));
}

// Quirk: LIBERO turns the world's difference by R_site where R_site' would lead into the site's
// frame. On a turned stove this takes points for the burner's that are not, and the reverse.
TEST_F(PredicatesTest, OnATurnedSiteUsesTheRotationNotItsTranspose) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose("libero_goal", "put_the_bowl_on_the_stove"));
  const std::string bowl = "akita_black_bowl_1", burner = "flat_stove_1_cook_region";
  const double yaw = std::numbers::pi / 8;
  ASSERT_NO_FATAL_FAILURE(PlaceWith({Turned("flat_stove_1", yaw)}));
  // 9 cm from the centre of a square of half size 7.5 cm: inside on a diagonal, outside on an axis.
  auto on = [&](double angle) {
    const Eigen::Vector3d offset(0.09 * std::cos(angle), 0.09 * std::sin(angle), 0.0235);
    const bool holds = HoldsAt(Site(burner) + offset, "on", bowl, burner);
    EXPECT_TRUE(InContact(*data_, scene_->objects.at("flat_stove_1"), scene_->objects.at(bowl)));
    return holds;
  };
  const double diagonal = std::numbers::pi / 4;
  EXPECT_TRUE(on(diagonal - yaw)) << "turned forth onto the diagonal; truly on the square's axis";
  EXPECT_FALSE(on(diagonal + yaw)) << "truly on the square's diagonal";
}

// Quirk: the half size is |R_site size|, a product before the absolute value, so that a turned box
// shrinks; the box stays along the world's axes. Below it reaches 1 cm further.
TEST_F(PredicatesTest, InATurnedRegionShrinksItsBox) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose(
      "libero_10", "KITCHEN_SCENE6_put_the_yellow_and_white_mug_in_the_microwave_and_close_it"));
  const double yaw = std::numbers::pi / 6, c = std::cos(yaw), s = std::sin(yaw);
  ASSERT_NO_FATAL_FAILURE(PlaceWith({Turned("microwave_1", yaw)}));
  const Eigen::Vector3d centre = Site("microwave_1_heating_region");
  const Eigen::Vector3d half(std::abs(c * 0.12 - s * 0.0835), std::abs(s * 0.12 + c * 0.0835),
                             0.08);
  auto in = [&](const Eigen::Vector3d& offset) {
    return HoldsAt(centre + offset, "in", "white_yellow_mug_1", "microwave_1_heating_region");
  };
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d unit = Eigen::Vector3d::Unit(axis);
    const double further = axis == 2 ? 0.01 : 0;
    EXPECT_TRUE(in((half[axis] - 1e-4) * unit)) << axis;
    EXPECT_FALSE(in((half[axis] + 1e-4) * unit)) << axis;
    EXPECT_TRUE(in(-(half[axis] + further - 1e-4) * unit)) << axis;
    EXPECT_FALSE(in(-(half[axis] + further + 1e-4) * unit)) << axis;
  }
}

TEST_F(PredicatesTest, CabinetsOpenAndCloseAtTheirThresholds) {
  SKIP_WITHOUT_SHARED_DATA();
  struct Cabinet {
    const char *name, *suite, *task;
  };
  for (const Cabinet& cabinet :
       {Cabinet{"wooden_cabinet_1", "libero_goal", "open_the_middle_drawer_of_the_cabinet"},
        {"white_cabinet_1", "libero_10",
         "KITCHEN_SCENE4_put_the_black_bowl_in_the_bottom_drawer_of_the_cabinet_and_close_it"}}) {
    ASSERT_NO_FATAL_FAILURE(Compose(cabinet.suite, cabinet.task));
    const std::string name = cabinet.name, drawer = name + "_bottom_region";
    const std::string joint = name + "_bottom_level";
    SCOPED_TRACE(name);
    EXPECT_FALSE(HoldsWith(joint, -0.14, "open", drawer)) << "q < -0.14 is open";
    EXPECT_TRUE(HoldsWith(joint, -0.14 - 1e-9, "open", drawer));
    EXPECT_FALSE(Holds("close", {drawer}));
    EXPECT_FALSE(HoldsWith(joint, 0, "close", drawer)) << "q > 0 is closed";
    EXPECT_TRUE(HoldsWith(joint, 1e-9, "close", drawer));
    EXPECT_FALSE(Holds("open", {drawer}));
    EXPECT_FALSE(HoldsWith(joint, -0.07, "open", drawer)) << "half way it is neither";
    EXPECT_FALSE(Holds("close", {drawer}));

    // The whole cabinet: any drawer opens it, all drawers close it.
    for (const char* level : {"_top_level", "_middle_level", "_bottom_level"})
      SetJoint(name + level, 0.005);
    EXPECT_FALSE(Holds("open", {name}));
    EXPECT_TRUE(Holds("close", {name}));
    EXPECT_TRUE(HoldsWith(joint, -0.15, "open", name));
    EXPECT_FALSE(Holds("close", {name}));
    // Quirk: a region that no joint moves is never open and always closed.
    EXPECT_FALSE(Holds("open", {name + "_top_side"}));
    EXPECT_TRUE(Holds("close", {name + "_top_side"}));
  }
}

TEST_F(PredicatesTest, TheMicrowaveOpensAndClosesAtItsThresholds) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose(
      "libero_10", "KITCHEN_SCENE6_put_the_yellow_and_white_mug_in_the_microwave_and_close_it"));
  const std::string joint = "microwave_1_microjoint", microwave = "microwave_1";
  EXPECT_FALSE(HoldsWith(joint, -1.3, "open", microwave));
  EXPECT_TRUE(HoldsWith(joint, -1.3 - 1e-9, "open", microwave));
  EXPECT_FALSE(Holds("close", {microwave}));
  EXPECT_FALSE(HoldsWith(joint, -0.005, "close", microwave));
  EXPECT_TRUE(HoldsWith(joint, -0.005 + 1e-9, "close", microwave));
  EXPECT_FALSE(Holds("open", {microwave}));
}

// Quirk: between 0 and 0.5 rad a stove is neither on nor off, and its rest position 0 is not off.
TEST_F(PredicatesTest, TheStoveTurnsOnAndOffAtItsThresholds) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose("libero_goal", "turn_on_the_stove"));
  const std::string knob = "flat_stove_1_button", stove = "flat_stove_1";
  EXPECT_FALSE(HoldsWith(knob, 0.5 - 1e-9, "turnon", stove));
  EXPECT_FALSE(Holds("turnoff", {stove}));
  EXPECT_TRUE(HoldsWith(knob, 0.5, "turnon", stove));
  EXPECT_FALSE(Holds("turnoff", {stove}));
  EXPECT_FALSE(HoldsWith(knob, 0, "turnoff", stove));
  EXPECT_FALSE(Holds("turnon", {stove}));
  EXPECT_TRUE(HoldsWith(knob, -1e-9, "turnoff", stove));
  EXPECT_FALSE(Holds("turnon", {stove}));
}

TEST_F(PredicatesTest, UpIsAHeightInTheWorld) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(Compose("libero_goal", "put_the_bowl_on_the_plate"));
  for (const auto& [z, up] : {std::pair(1.0, true), {1.0 - 1e-9, false}, {1.5, true}}) {
    Put("akita_black_bowl_1", {0.1, 0.1, z});
    Forward();
    EXPECT_EQ(Holds("up", {"akita_black_bowl_1"}), up) << z;
  }
}

TEST_F(PredicatesTest, AGoalHoldsWhenAllOfItsPartsDo) {
  SKIP_WITHOUT_SHARED_DATA();
  ASSERT_NO_FATAL_FAILURE(
      Compose("libero_10", "KITCHEN_SCENE3_turn_on_the_stove_and_put_the_moka_pot_on_it"));
  const absl::StatusOr<LiberoGoal> goal = LiberoGoal::Create(*scene_);
  ASSERT_TRUE(goal.ok()) << goal.status();
  EXPECT_THAT(goal->Evaluate(*data_), ElementsAre(false, false));
  SetJoint("flat_stove_1_button", 1);
  Forward();
  EXPECT_THAT(goal->Evaluate(*data_), ElementsAre(true, false));
  EXPECT_FALSE(goal->Holds(*data_));
  // Lowered until it touches the stove.
  for (double z = 0.1; z > 0 && !goal->Holds(*data_); z -= 0.001) {
    Put("moka_pot_1", Site("flat_stove_1_cook_region") + Eigen::Vector3d(0, 0, z));
    Forward();
  }
  EXPECT_THAT(goal->Evaluate(*data_), ElementsAre(true, true));
  EXPECT_TRUE(goal->Holds(*data_));
}

}  // namespace
}  // namespace robostress::libero
