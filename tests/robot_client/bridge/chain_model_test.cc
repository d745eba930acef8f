#include "robot_client/bridge/chain_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/robot_description.h"
#include "tests/robot_client/bridge/seven_joints.h"
#include "tests/sim_worker/allocation_counter.h"

namespace robostress::bridge {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

ArmChain Chain(const std::string& urdf = SevenUrdf(), const ModelOptions& options = SevenModel()) {
  auto chain = ReadArmChain("seven.urdf", urdf, SevenNames(), SevenLimits(), options);
  EXPECT_TRUE(chain.ok()) << chain.status();
  return *std::move(chain);
}

std::string ChainRefusal(const std::string& urdf, const ModelOptions& options = SevenModel(),
                         std::vector<std::string> joints = SevenNames(),
                         const ArmLimits& limits = SevenLimits()) {
  const auto chain = ReadArmChain("seven.urdf", urdf, joints, limits, options);
  EXPECT_FALSE(chain.ok());
  return std::string(chain.status().message());
}

std::string Changed(const std::string& from, const std::string& to) {
  const std::string changed = absl::StrReplaceAll(SevenUrdf(), {{from, to}});
  EXPECT_NE(changed, SevenUrdf()) << from;
  return changed;
}

TEST(ChainModel, AFrankasToolIsWhereItsReadyPoseHasIt) {
  const ChainModel model(Chain(), {});
  const Eigen::Vector3d tool =
      model.ToolAt({0, -M_PI / 4, 0, -3 * M_PI / 4, 0, M_PI / 2, M_PI / 4, 0.04});
  // What a Panda's interface reports there as O_T_EE with its hand.
  EXPECT_NEAR(tool.x(), 0.306891, 1e-6);
  EXPECT_NEAR(tool.y(), 0, 1e-9);
  EXPECT_NEAR(tool.z(), 0.486882, 1e-6);
}

TEST(ChainModel, TableAndBoxAreKeptByTheNearestPartBeyondTheFirstLink) {
  WorkspaceOptions workspace;
  workspace.table_z = 0.1;
  workspace.margin = 0.01;
  workspace.lower = {-1, -1, -1};
  workspace.upper = {0.6, 1, 2};
  const ChainModel model(Chain(), workspace);
  const ArmVector low = {0, 0.2, 0, -2.3, 0, 2.5, M_PI / 4, 0};  // the tool points down
  const Eigen::Vector3d tool = model.ToolAt(low);
  ASSERT_LT(tool.z(), 0.3);
  const ArmModel::Clearance clearance = model.ClearanceAt(low);
  // The fingers' balls of 15 mm are 88.4 mm below the hand, the tool's point 103.4 mm.
  EXPECT_NEAR(clearance[ArmModel::kTable], tool.z() - 0.1 - 0.01, 1e-9);
  // The hand is 40 mm wide that way, and the last wrist's ball of 50 mm is 88 mm nearer.
  EXPECT_NEAR(clearance[ArmModel::kBox], 0.6 - tool.x() - 0.05 - 0.01, 1e-9);
  EXPECT_EQ(clearance[ArmModel::kItself], std::numeric_limits<double>::infinity());
  // A finger's ball of 0.1 m would reach 85 mm further than the tool.
  const ChainModel thick(Chain(Changed("sphere radius=\"0.015\"", "sphere radius=\"0.1\"")),
                         workspace);
  EXPECT_NEAR(thick.ClearanceAt(low)[ArmModel::kTable], tool.z() - 0.085 - 0.1 - 0.01, 1e-9);
  // Bent backwards with its forearm up, the upper arm's cylinder is the lowest.
  EXPECT_NEAR(model.ClearanceAt({0, -1.7, 0, -2, 0, 1.9, 0, 0})[ArmModel::kTable],
              0.333 + 0.316 * std::cos(1.7) - 0.06 - 0.1 - 0.01, 1e-9);
  // The shoulder's ball reaches down to 0.283 m and cannot leave: it hides nothing of the others.
  workspace.table_z = 0.32;
  const ArmVector ready = {0, -M_PI / 4, 0, -3 * M_PI / 4, 0, M_PI / 2, M_PI / 4, 0};
  EXPECT_NEAR(ChainModel(Chain(), workspace).ClearanceAt(ready)[ArmModel::kTable], 0.025, 1e-3)
      << "the upper arm's cylinder";
}

// The lowest point and the highest of the last link's shape, in its own frame.
std::pair<double, double> HandShape(const std::string& urdf) {
  double lowest = 1e9, highest = -1e9;
  const ArmChain chain = Chain(urdf);
  for (const Ball& ball : chain.links.back().shape) {
    lowest = std::min(lowest, ball.centre.y() - ball.radius);
    highest = std::max(highest, ball.centre.z() + ball.radius);
  }
  return {lowest, highest};
}

TEST(ChainModel, ShapesAreBoxesCylindersSpheresAndBallsForMeshes) {
  const ArmChain chain = Chain();
  // The third link's cylinder, 0.2 m long about z = -0.1.
  ASSERT_EQ(chain.links[2].shape.size(), 2u);
  EXPECT_NEAR(chain.links[2].shape[0].centre.z(), 0, 1e-12);
  EXPECT_NEAR(chain.links[2].shape[1].centre.z(), -0.2, 1e-12);
  EXPECT_EQ(chain.links[2].shape[1].radius, 0.06);
  // A mesh: the ball of model.radius.
  ASSERT_EQ(chain.links[3].shape.size(), 1u);
  EXPECT_EQ(chain.links[3].shape[0].radius, 0.05);
  // The hand's box is 0.2 m long, turned by 45 degrees; the tool is a point.
  const auto [lowest, highest] = HandShape(SevenUrdf());
  EXPECT_NEAR(lowest, -std::sqrt(0.5) * (0.1 + 0.02), 1e-9);
  EXPECT_NEAR(highest, 0.107 + 0.1034, 1e-9);
  EXPECT_NEAR(HandShape(Changed("sphere radius=\"0.015\"", "sphere radius=\"0.1\"")).second,
              0.107 + 0.0584 + 0.03 + 0.1, 1e-9);
}

TEST(ChainModel, AFixedLinksMassIsItsCarriers) {
  const ArmChain chain = Chain();
  EXPECT_NEAR(chain.links[6].mass, 0.7 + 0.6 + 2 * 0.05, 1e-12);
  EXPECT_NEAR(chain.links[0].mass, 4, 1e-12);
  const double z = (0.7 * 0.06 + 0.6 * (0.107 + 0.03) + 0.1 * (0.107 + 0.0584 + 0.02)) / 1.4;
  EXPECT_NEAR(chain.links[6].centre.z(), z, 1e-12);
}

TEST(ChainModel, APayloadHangsAtTheTool) {
  const ChainModel model(Chain(), {});
  const ArmVector pose = {0, 0.9, 0, -1.4, 0, 1.9, 0, 0};
  const ArmVector with = model.Torque(pose, {}, {}, 2), without = model.Torque(pose, {}, {}, 0);
  // About J2, whose axis is y through the shoulder: 2 kg at the tool's distance.
  EXPECT_NEAR(with[1] - without[1], -2 * 9.81 * model.ToolAt(pose).x(), 1e-9);
  EXPECT_NEAR(with[0] - without[0], 0, 1e-9) << "upright";
  EXPECT_EQ(with[7], 0) << "the gripper";
}

TEST(ChainModel, TheControlThreadAllocatesNothing) {
  if (!CountsAllocations()) GTEST_SKIP() << "a sanitizer owns malloc";
  const ChainModel model(Chain(), {});
  const ArmVector pose = {0, 0.9, 0, -1.4, 0, 1.9, 0, 0};
  const long before = Allocations();
  double sum = 0;
  for (int i = 0; i < 10; ++i)
    sum += model.ClearanceAt(pose)[0] + model.Torque(pose, pose, pose, 0.5)[1];
  EXPECT_EQ(Allocations(), before);
  EXPECT_TRUE(std::isfinite(sum));
}

TEST(ChainModel, DamagedFilesAreRefusedOrGiveFiniteNumbers) {
  const std::string whole = SevenUrdf();
  std::mt19937 random(3);
  const std::string pieces[] = {"-", "1e300", "nan", "\"", "<", "/>", "0", " ", "e", "<link"};
  int read = 0;
  for (int k = 0; k < 3000; ++k) {
    std::string text = whole;
    for (int n = 0; n < 1 + k % 3; ++n) {
      const size_t at = random() % text.size();
      if (random() % 4 == 0) {
        text.erase(at, random() % 40);
      } else {
        text.replace(at, random() % 3, pieces[random() % std::size(pieces)]);
      }
    }
    const auto chain =
        ReadArmChain("damaged.urdf", text, SevenNames(), SevenLimits(), SevenModel());
    if (!chain.ok()) {
      EXPECT_THAT(std::string(chain.status().message()),
                  ::testing::AnyOf(HasSubstr("damaged.urdf"), HasSubstr("model.tool")));
      continue;
    }
    ++read;
    const ChainModel model(*chain, {});
    const ArmVector pose = {0.1, 0.9, -0.4, -1.4, 0.3, 1.9, 0.2, 0.02};
    for (const double torque : model.Torque(pose, pose, pose, 0.5))
      ASSERT_TRUE(std::isfinite(torque)) << text;
    ASSERT_FALSE(std::isnan(model.ClearanceAt(pose)[ArmModel::kTable])) << text;
  }
  EXPECT_GT(read, 100) << "not every digit matters";
}

TEST(ChainModel, RefusalsNameFilePlaceAndRemedy) {
  std::vector<std::string> swapped = SevenNames();
  std::swap(swapped[2], swapped[3]);
  EXPECT_THAT(
      ChainRefusal(SevenUrdf(), SevenModel(), swapped),
      AllOf(HasSubstr("seven.urdf: joint 'panda_joint3' is J4"), HasSubstr("from the base on")));
  std::vector<std::string> twice = SevenNames();
  twice[6] = twice[5];
  EXPECT_FALSE(ReadArmChain("seven.urdf", SevenUrdf(), twice, SevenLimits(), SevenModel()).ok());
  std::vector<std::string> unknown = SevenNames();
  unknown[6] = "wrist";
  EXPECT_THAT(ChainRefusal(SevenUrdf(), SevenModel(), unknown),
              AllOf(HasSubstr("no joint 'wrist'"), HasSubstr("panda_joint7")));
  std::vector<std::string> slides = SevenNames();
  slides[6] = "left_finger_joint";
  EXPECT_THAT(ChainRefusal(SevenUrdf(), SevenModel(), slides), HasSubstr("slides"));
  ModelOptions tool = SevenModel();
  tool.tool = "link3";
  EXPECT_THAT(ChainRefusal(SevenUrdf(), tool),
              AllOf(HasSubstr("model.tool is 'link3'"), HasSubstr("hand"), HasSubstr("tcp")));
  EXPECT_THAT(ChainRefusal("<mujoco/>"), AllOf(HasSubstr("seven.urdf:1"), HasSubstr("reads URDF")));
  EXPECT_THAT(ChainRefusal("<robot"), HasSubstr("seven.urdf:1"));
  EXPECT_THAT(ChainRefusal(Changed("xyz=\"0 -0.316 0\"", "xyz=\"0 -316 0\"")),
              HasSubstr("316 m from the one before"));
  EXPECT_THAT(ChainRefusal(Changed("sphere radius=\"0.015\"", "sphere radius=\"15\"")),
              AllOf(HasSubstr("seven.urdf:"), HasSubstr("<sphere> is larger")));
  EXPECT_THAT(ChainRefusal(Changed("sphere radius=\"0.015\"", "sphere radius=\"nan\"")),
              HasSubstr("finite"));
  EXPECT_THAT(ChainRefusal(Changed("box size=\"0.04 0.2 0.06\"", "box size=\"0.04 -0.2 0.06\"")),
              HasSubstr("<box>"));
  ArmLimits turned = SevenLimits();
  turned.lower[3] = 0.2;
  turned.upper[3] = 3.0;  // a driver that counts J4 the other way round
  EXPECT_THAT(
      ChainRefusal(SevenUrdf(), SevenModel(), SevenNames(), turned),
      AllOf(HasSubstr("'panda_joint4' goes from -3.0718 to -0.0698"), HasSubstr("sign and zero")));
  std::string many;
  for (int i = 0; i < 600; ++i)
    absl::StrAppend(&many, "<collision><geometry><sphere radius=\"0.01\"/></geometry></collision>");
  EXPECT_THAT(ChainRefusal(Changed("</geometry></collision>\n  </link>\n  <link name=\"left",
                                   absl::StrCat("</geometry></collision>", many,
                                                "\n  </link>\n  <link name=\"left"))),
              HasSubstr("at most 512"));
}

}  // namespace
}  // namespace robostress::bridge
