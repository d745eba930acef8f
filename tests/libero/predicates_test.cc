// Goal predicates, true and false, by placing the objects of LIBERO's own scenes.
#include "sim_worker/libero/predicates.h"

#include <gmock/gmock.h>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_join.h"
#include "tests/libero/shared_data.h"

namespace robostress::libero {
namespace {

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
    const absl::StatusOr<SharedModel> model = PlaceFixtures(*scene_, scene_->centred_fixtures);
    ASSERT_TRUE(model.ok()) << model.status();
    model_ = *model;
    data_.reset(mj_makeData(model_.get()));
    // Every object far from every other.
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

}  // namespace
}  // namespace robostress::libero
