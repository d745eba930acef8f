#include "robot_client/bridge/chain_model.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <limits>
#include <random>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/robot_description.h"
#include "robot_client/capsule.h"
#include "tests/common/models/mesh_samples.h"
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
  EXPECT_NEAR(clearance[ArmModel::kBox + 3], 0.6 - tool.x() - 0.05 - 0.01, 1e-9);
  EXPECT_NEAR(clearance[ArmModel::kBox + 2], tool.z() + 1 - 0.01, 1e-9) << "the floor, by itself";
  // A finger's ball of 0.1 m would reach 85 mm further than the tool.
  const ChainModel thick(Chain(Changed("sphere radius=\"0.015\"", "sphere radius=\"0.1\"")),
                         workspace);
  EXPECT_NEAR(thick.ClearanceAt(low)[ArmModel::kTable], tool.z() - 0.085 - 0.1 - 0.01, 1e-9);
  // Bent backwards with its forearm up, the rim of the upper arm's cylinder is the lowest; its
  // prism has corners of 61.2 mm where it has 60.
  const double rim = 0.333 + 0.316 * std::cos(1.7) - 0.06 * std::sin(1.7) - 0.1 - 0.01;
  const double seen = model.ClearanceAt({0, -1.7, 0, -2, 0, 1.9, 0, 0})[ArmModel::kTable];
  EXPECT_LE(seen, rim);
  EXPECT_GE(seen, rim - 0.0013);
  // The shoulder's ball reaches down to 0.283 m and cannot leave: it hides nothing of the others.
  workspace.table_z = 0.32;
  const ArmVector ready = {0, -M_PI / 4, 0, -3 * M_PI / 4, 0, M_PI / 2, M_PI / 4, 0};
  ArmChain chain = Chain();
  ASSERT_TRUE(LeaveLowPartsOut(SevenLimits(), workspace, &chain).ok());
  ASSERT_EQ(chain.below_table.size(), 1u);
  EXPECT_EQ(chain.below_table[0].link, 1);
  EXPECT_TRUE(chain.below_table[0].all);
  EXPECT_NEAR(ChainModel(chain, workspace).ClearanceAt(ready)[ArmModel::kTable], 0.042, 1e-3)
      << "the upper arm's cylinder";
  // The box goes on holding it, and leaves it out only below its own floor.
  EXPECT_TRUE(chain.below_box.empty());
  workspace.lower = {-1, -0.04, -1};
  const ChainModel boxed(chain, workspace);
  EXPECT_NEAR(boxed.ClearanceAt({M_PI / 2, 0.8, 0, -1.5, 0, 1.9, 0, 0})[ArmModel::kBox + 1],
              0.04 - 0.05 - 0.01, 1e-9);
  workspace.lower = {-1, -1, 0.32};
  ArmChain floored = Chain();
  ASSERT_TRUE(LeaveLowPartsOut(SevenLimits(), workspace, &floored).ok());
  ASSERT_EQ(floored.below_box.size(), 1u);
  EXPECT_NEAR(ChainModel(floored, workspace).ClearanceAt(ready)[ArmModel::kBox + 2], 0.042, 1e-3);
}

// Nothing would be watched, and everything would look as far away as can be.
TEST(ChainModel, ATableAboveTheArmIsRefused) {
  WorkspaceOptions workspace;
  workspace.table_z = 2;
  ArmChain chain = Chain();
  EXPECT_THAT(std::string(LeaveLowPartsOut(SevenLimits(), workspace, &chain).message()),
              AllOf(HasSubstr("workspace.table_z is 2 m"), HasSubstr("in the base frame: J7"),
                    HasSubstr("correct the height")));
  workspace = {};
  workspace.margin = 0.5;
  workspace.table_z = 1.2;
  chain = Chain();
  EXPECT_THAT(std::string(LeaveLowPartsOut(SevenLimits(), workspace, &chain).message()),
              HasSubstr("margin 0.5 m"));
  workspace = {};
  workspace.lower[2] = 2;
  workspace.upper[2] = 3;
  chain = Chain();
  EXPECT_THAT(std::string(LeaveLowPartsOut(SevenLimits(), workspace, &chain).message()),
              HasSubstr("workspace.lower[2] is 2 m"));
}

std::vector<const LinkPart*> PartsOfLink(const ArmChain& chain, int link) {
  std::vector<const LinkPart*> parts;
  for (const LinkPart& part : chain.body)
    if (part.link == link) parts.push_back(&part);
  return parts;
}

// How far the shapes of the last link reach along a direction, in its own frame.
double HandReach(const std::string& urdf, const Eigen::Vector3d& along) {
  double reach = -1e9;
  const ArmChain chain = Chain(urdf);
  for (const LinkPart* part : PartsOfLink(chain, 6))
    for (const Eigen::Vector3d& corner : part->shape.corners)
      reach = std::max(reach, along.dot(corner) + part->shape.radius);
  return reach;
}

TEST(ChainModel, ShapesAreBoxesCylindersSpheresAndBallsForMeshesThatAreNotThere) {
  const ArmChain chain = Chain();
  // The third link's cylinder, 0.2 m long about z = -0.1, in a prism that holds it.
  const auto third = PartsOfLink(chain, 2);
  ASSERT_EQ(third.size(), 1u);
  double lowest = 1, highest = -1, inner = 1, outer = 0;
  for (const Eigen::Vector3d& corner : third[0]->shape.corners) {
    lowest = std::min(lowest, corner.z()), highest = std::max(highest, corner.z());
    inner = std::min(inner, corner.head<2>().norm());
    outer = std::max(outer, corner.head<2>().norm());
  }
  EXPECT_NEAR(lowest, -0.2, 1e-12);
  EXPECT_NEAR(highest, 0, 1e-12);
  EXPECT_NEAR(inner * std::cos(M_PI / 16), 0.06, 1e-9);
  EXPECT_NEAR(outer, inner, 1e-9);
  // A mesh that is not there: the ball of model.radius for the table, a bone against the arm.
  const auto fourth = PartsOfLink(chain, 3);
  ASSERT_EQ(fourth.size(), 2u);
  EXPECT_EQ(fourth[0]->shape.radius, 0.05);
  EXPECT_TRUE(fourth[0]->against_table && fourth[0]->against_box && !fourth[0]->against_itself);
  EXPECT_TRUE(!fourth[1]->against_table && !fourth[1]->against_box && fourth[1]->against_itself);
  EXPECT_EQ(chain.meshes, 0);
  EXPECT_THAT(chain.missing_meshes,
              ::testing::ElementsAre("link.stl (not found)", "link.stl (not found)",
                                     "link.stl (not found)", "link.stl (not found)",
                                     "link.stl (not found)", "link.stl (not found)"));
  // The hand's box is 0.2 m long, turned by 45 degrees; the tool is a point.
  EXPECT_NEAR(HandReach(SevenUrdf(), -Eigen::Vector3d::UnitY()), std::sqrt(0.5) * (0.1 + 0.02),
              1e-9);
  EXPECT_NEAR(HandReach(SevenUrdf(), Eigen::Vector3d::UnitZ()), 0.107 + 0.1034, 1e-9);
  EXPECT_NEAR(HandReach(Changed("sphere radius=\"0.015\"", "sphere radius=\"0.1\""),
                        Eigen::Vector3d::UnitZ()),
              0.107 + 0.0584 + 0.03 + 0.1, 1e-9);
}

// Exporters give frames some mass, because a simulator asks for it: that is no body of 50 mm.
TEST(ChainModel, AFrameOfAMilligramIsAPoint) {
  const auto tool = [](const char* mass) {
    const std::string inertial =
        absl::StrCat("<link name=\"tcp\"><inertial><mass value=\"", mass,
                     "\"/><inertia ixx=\"1e-6\" iyy=\"1e-6\" izz=\"1e-6\" ixy=\"0\" ixz=\"0\" "
                     "iyz=\"0\"/></inertial></link>");
    return HandReach(Changed("<link name=\"tcp\"/>", inertial), Eigen::Vector3d::UnitZ());
  };
  EXPECT_NEAR(tool("1e-6"), 0.107 + 0.1034, 1e-9);
  EXPECT_NEAR(tool("0.2"), 0.107 + 0.1034 + 0.05, 1e-9);
}

TEST(ChainModel, AnArmsMeshesAreItsShape) {
  const std::string folder = ::testing::TempDir() + "chain_meshes/";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder);
  const auto put = [&](const std::string& name, const std::string& text) {
    EXPECT_TRUE(WriteFileAtomically(folder + name, text).ok());
    return folder + name;
  };
  const std::string urdf = put("seven.urdf", SevenUrdf());
  const auto read = [&] {
    return ReadArmChain(urdf, SevenUrdf(), SevenNames(), SevenLimits(), SevenModel());
  };
  auto without = read();
  ASSERT_TRUE(without.ok()) << without.status();
  EXPECT_EQ(without->meshes, 0);
  EXPECT_EQ(without->missing_meshes.size(), 6u);
  put("link.stl", BinaryStl(BoxMesh({-0.02, -0.03, -0.04}, {0.02, 0.03, 0.04})));
  auto with = read();
  ASSERT_TRUE(with.ok()) << with.status();
  EXPECT_EQ(with->meshes, 6);
  EXPECT_TRUE(with->missing_meshes.empty());
  // The wrist is 40 mm thick where a ball of 50 mm was: with the fingers away it is the lowest
  // part.
  const ArmVector level = {0, 0, 0, -1.5, 0, 1.5, 0, 0};
  WorkspaceOptions wide;
  wide.table_z = -1;
  wide.lower = {-5, -5, -5};
  wide.upper = {5, 5, 5};
  EXPECT_GT(ChainModel(*with, wide).ClearanceAt(level)[ArmModel::kTable],
            ChainModel(*without, wide).ClearanceAt(level)[ArmModel::kTable] - 1e-9);
  ChooseLinkPairs(SevenLimits(), {}, 0, {}, &*with);
  EXPECT_FALSE(with->watched.empty());

  put("link.stl", BinaryStl(BoxMesh({-20, -30, -40}, {20, 30, 40})));
  auto large = read();
  EXPECT_THAT(std::string(large.status().message()),
              AllOf(HasSubstr("seven.urdf:"), HasSubstr("link.stl is 80 m"),
                    HasSubstr("scale=\"0.001 0.001 0.001\"")));
  const std::string scaled =
      absl::StrReplaceAll(SevenUrdf(), {{"link.stl\"", "link.stl\" scale=\"0.001 -0.001 0.001\""}});
  EXPECT_TRUE(ReadArmChain(urdf, scaled, SevenNames(), SevenLimits(), SevenModel()).ok());
  put("link.stl", "solid");
  EXPECT_THAT(std::string(read().status().message()), HasSubstr("link.stl"));
}

ArmChain ChosenChain(double margin = 0, const std::string& urdf = SevenUrdf(),
                     const std::vector<LinkPair>& ignored = {}) {
  ArmChain chain = Chain(urdf);
  const std::vector<double> ready = {0, -M_PI / 4, 0, -3 * M_PI / 4, 0, M_PI / 2, M_PI / 4, 0.04};
  ChooseLinkPairs(SevenLimits(), ready, margin, ignored, &chain);
  return chain;
}

bool Watched(const ArmChain& chain, int first, int second) {
  return std::any_of(chain.watched.begin(), chain.watched.end(), [&](const auto& pair) {
    return chain.body[pair.first].link == first && chain.body[pair.second].link == second;
  });
}

TEST(ChainModel, TheArmIsWatchedAgainstItself) {
  const ArmChain chain = ChosenChain();
  EXPECT_TRUE(Watched(chain, 1, 6)) << "the upper arm and the hand";
  EXPECT_TRUE(Watched(chain, 3, 6)) << "the forearm and the hand, though not its flange";
  ModelOptions thin_links = SevenModel();
  thin_links.radius = 0.01;
  ArmChain thin = Chain(Changed("<origin xyz=\"0 0 0.03\"/><geometry><box",
                                "<origin xyz=\"0.1 0 0.03\"/><geometry><box"),
                        thin_links);  // the last joint turns it about the link before
  ChooseLinkPairs(SevenLimits(), {}, 0, {}, &thin);
  for (const auto& [a, b] : thin.watched)
    EXPECT_GE(thin.body[b].link - thin.body[a].link, 2) << "a joint connects them";
  EXPECT_FALSE(Watched(chain, 0, 2)) << "they turn about one line: always as far";
  EXPECT_TRUE(chain.too_near.empty());
  const ChainModel model(chain, {});
  const auto clearance = [&](double j4, double j6) {
    return model.ClearanceAt({0, 0, 0, j4, 0, j6, 0, 0})[ArmModel::kItself];
  };
  EXPECT_GT(clearance(-2, 1.6), 0.05);
  // Folded as far as it goes, the hand turned inwards is in the upper arm, and deeper with J4.
  EXPECT_LT(clearance(-3, 0.6), -0.05);
  EXPECT_LT(clearance(-3, 0.6), clearance(-2.9, 0.6) - 0.005);
  WorkspaceOptions wide;
  wide.margin = 0.03;
  EXPECT_NEAR(ChainModel(chain, wide).ClearanceAt({0, 0, 0, -2, 0, 1.6, 0, 0})[ArmModel::kItself],
              clearance(-2, 1.6) - 0.03, 1e-12);
}

TEST(ChainModel, HullsOfTwoCornersAreAsFarAsThePipersCapsules) {
  std::mt19937 random(1);
  std::uniform_real_distribution<double> share(-1, 1);
  const auto vector = [&] { return Eigen::Vector3d(share(random), share(random), share(random)); };
  for (int k = 0; k < 2000; ++k) {
    const Capsule a{vector(), vector(), 0.05}, b{vector(), vector(), 0.02};
    Eigen::Isometry3d T(Eigen::AngleAxisd(3 * share(random), vector().normalized()));
    T.translation() = vector();
    const Hull hull{{T.inverse() * b.from, T.inverse() * b.to}, b.radius};
    EXPECT_NEAR(Distance({{a.from, a.to}, a.radius}, hull, T), Distance(a, b), 2e-6) << k;
  }
}

// Looking at balls first finds the same as looking at every pair.
TEST(ChainModel, NoPairIsNearerThanTheNearest) {
  const ArmChain chain = ChosenChain();
  const ChainModel model(chain, {});
  std::mt19937 random(8);
  for (int k = 0; k < 300; ++k) {
    ArmVector pose{};
    std::vector<Eigen::Isometry3d> T(8, Eigen::Isometry3d::Identity());  // of the base first
    for (size_t j = 0; j < 7; ++j) {
      pose[j] = std::uniform_real_distribution<double>(SevenLimits().lower[j],
                                                       SevenLimits().upper[j])(random);
      T[j + 1] =
          T[j] * chain.links[j].T_before_joint * Eigen::AngleAxisd(pose[j], chain.links[j].axis);
    }
    double nearest = 1;
    for (const auto& [a, b] : chain.watched) {
      const LinkPart &first = chain.body[a], &second = chain.body[b];
      nearest = std::min(nearest, Distance(first.shape, second.shape,
                                           T[first.link + 1].inverse() * T[second.link + 1]));
    }
    ASSERT_NEAR(model.ClearanceAt(pose)[ArmModel::kItself], nearest, 1e-6) << "pose " << k;
  }
}

TEST(ChainModel, WhatTouchesIsNamedAndMayBeLeftOut) {
  const ArmVector folded = {0, 0, 0, -3, 0, 0.6, 0, 0};
  const ArmChain all = ChosenChain();
  const std::string parts = ChainModel(all, {}).NearestParts(folded);
  EXPECT_EQ(parts, "J2 and J7");
  const ArmChain without = ChosenChain(0, SevenUrdf(), {LinkPair{2, 6}, LinkPair{1, 6}});
  EXPECT_FALSE(Watched(without, 2, 6));
  EXPECT_EQ(ChainModel(without, {}).NearestParts(folded), "J1 and J7");
  EXPECT_GT(ChainModel(without, {}).ClearanceAt(folded)[ArmModel::kItself],
            ChainModel(all, {}).ClearanceAt(folded)[ArmModel::kItself]);
  EXPECT_EQ(*ParseLinkPair("J7-J3", 7), (LinkPair{2, 6}));
  EXPECT_EQ(*ParseLinkPair("base-J2", 7), (LinkPair{-1, 1}));
  for (const char* wrong : {"", "J3", "J3-J3", "J0-J3", "J3-J8", "J3-J4-J5", "3-5", "hand-base"}) {
    EXPECT_THAT(std::string(ParseLinkPair(wrong, 7).status().message()),
                AllOf(HasSubstr(wrong), HasSubstr("J1 to J7")));
  }
}

TEST(ChainModel, WhatIsNearerAtHomeThanTheMarginIsNotWatched) {
  const size_t all = ChosenChain().watched.size();
  EXPECT_GT(all, 20u);
  EXPECT_NEAR(ChosenChain().touching, 0.1, 0.05);
  ModelOptions thick = SevenModel();
  thick.radius = 0.12;
  ArmChain coarse = Chain(SevenUrdf(), thick);
  ChooseLinkPairs(SevenLimits(), {}, 0, {}, &coarse);
  EXPECT_GT(coarse.touching, 0.15);
  const double before = coarse.touching;
  ChooseLinkPairs(SevenLimits(), {}, 0, {coarse.touching_most}, &coarse);
  EXPECT_LT(coarse.touching, before);
  EXPECT_LT(ChosenChain(0.3).watched.size(), all);
  EXPECT_FALSE(Watched(ChosenChain(0.3), 3, 6));
  EXPECT_THAT(ChosenChain(0.3).too_near, ::testing::Contains(LinkPair{3, 6}));
  // An arm that rests with its hand in its upper arm's shape must be able to go there.
  const ArmVector folded = {0, 0, 0, -3, 0, 0.6, 0, 0};
  ArmChain chain = Chain();
  ChooseLinkPairs(SevenLimits(), {folded.begin(), folded.end()}, 0, {}, &chain);
  EXPECT_GE(ChainModel(chain, {}).ClearanceAt(folded)[ArmModel::kItself], 0);
}

// A table that belongs to the file is no 13 cm thick for being 2 m long.
TEST(ChainModel, ABoxOfTheBaseIsABox) {
  const ArmChain chain = ChosenChain(
      0,
      Changed("<link name=\"base\"/>",
              "<link name=\"base\"><collision><origin xyz=\"0.6 0 -0.02\"/><geometry><box size=\"2 "
              "1.5 0.04\"/></geometry></collision></link>"));
  EXPECT_TRUE(Watched(chain, -1, 6));
  const ChainModel model(chain, {});
  ArmVector low = {0, 0.35, 0, -2.2, 0, 2.55, M_PI / 4, 0};  // the hand points down
  for (; model.ToolAt(low).z() > 0.03; low[1] += 0.01) low[5] += 0.01;
  const double height = model.ToolAt(low).z();
  EXPECT_NEAR(model.ClearanceAt(low)[ArmModel::kItself], height, 0.002)
      << "the fingers' balls of 15 mm end with the tool";
  EXPECT_EQ(model.NearestParts(low), "the base and J7");
}

TEST(ChainModel, TheGroundMayBelongToTheFile) {
  const auto with = [](const char* size) {
    return Changed("<link name=\"base\"/>",
                   absl::StrCat("<link name=\"base\"><collision><geometry><box size=\"", size,
                                "\"/></geometry></collision></link>"));
  };
  const ArmChain chain = Chain(with("200 200 0.1"));
  const auto ground = PartsOfLink(chain, -1);
  ASSERT_EQ(ground.size(), 1u);
  EXPECT_TRUE(ground[0]->against_itself);
  EXPECT_FALSE(PartsOfLink(Chain(), -1)[0]->against_itself) << "a frame is a point";
  EXPECT_THAT(ChainRefusal(with("20000 20000 10")), HasSubstr("<box> is larger than 1000"));
}

TEST(ChainModel, TooManyPartsAreNotWatchedAgainstEachOther) {
  std::string many;
  for (int i = 0; i < 260; ++i)
    absl::StrAppend(&many, "<collision><geometry><sphere radius=\"0.01\"/></geometry></collision>");
  const ArmChain chain = ChosenChain(
      0, Changed("<link name=\"base\"/>", absl::StrCat("<link name=\"base\">", many, "</link>")));
  EXPECT_TRUE(chain.watched.empty());
  EXPECT_EQ(ChainModel(chain, {}).ClearanceAt({})[ArmModel::kItself],
            std::numeric_limits<double>::infinity());
}

// A joint of seven.urdf that is not driven, between J7 and the hand.
std::string WithWrist(const std::string& mimic, const std::string& type = "revolute") {
  return Changed(
      "<joint name=\"hand_joint\" type=\"fixed\">\n    <parent link=\"link7\"/>",
      absl::StrCat("<link name=\"wrist\"/>\n<joint name=\"wrist_joint\" type=\"", type,
                   "\">\n<parent link=\"link7\"/><child link=\"wrist\"/>", mimic,
                   "</joint>\n<joint name=\"hand_joint\" type=\"fixed\"><parent link=\"wrist\"/>"));
}

TEST(ChainModel, AJointOnTheWayToTheToolThatIsNotDrivenIsNamedOrRefused) {
  EXPECT_TRUE(Chain().held.empty()) << "fingers are not on the way";
  EXPECT_THAT(Chain(WithWrist("")).held, ::testing::ElementsAre("wrist_joint"));
  EXPECT_TRUE(Chain(WithWrist("", "fixed")).held.empty());
  EXPECT_THAT(Chain(WithWrist("<mimic joint=\"left_finger_joint\"/>")).held,
              ::testing::ElementsAre("wrist_joint"))
      << "what it follows stands still";
  const std::string with = WithWrist("<mimic joint=\"panda_joint6\" multiplier=\"-1\"/>");
  EXPECT_THAT(ChainRefusal(with),
              AllOf(::testing::ContainsRegex("seven.urdf:[0-9]+: joint 'wrist_joint' moves with "
                                             "'panda_joint6'"),
                    HasSubstr("leave model out")));
  const std::string over =
      absl::StrReplaceAll(WithWrist("<mimic joint=\"left_finger_joint\"/>"),
                          {{"<limit lower=\"0\" upper=\"0.04\" effort=\"20\" velocity=\"0.2\"/>",
                            "<mimic joint=\"panda_joint3\"/>"}});
  EXPECT_THAT(ChainRefusal(over), HasSubstr("moves with 'panda_joint3'"));
  EXPECT_TRUE(Chain(Changed("<limit lower=\"0\" upper=\"0.04\" effort=\"20\" velocity=\"0.2\"/>",
                            "<mimic joint=\"panda_joint3\"/>"))
                  .held.empty())
      << "a finger carries no tool";
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
  const ChainModel model(ChosenChain(), {});
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
    auto chain = ReadArmChain("damaged.urdf", text, SevenNames(), SevenLimits(), SevenModel());
    if (!chain.ok()) {
      EXPECT_THAT(std::string(chain.status().message()),
                  ::testing::AnyOf(HasSubstr("damaged.urdf"), HasSubstr("model.tool")));
      continue;
    }
    ++read;
    ChooseLinkPairs(SevenLimits(), {}, 0, {}, &*chain);
    const ChainModel model(*chain, {});
    const ArmVector pose = {0.1, 0.9, -0.4, -1.4, 0.3, 1.9, 0.2, 0.02};
    for (const double torque : model.Torque(pose, pose, pose, 0.5))
      ASSERT_TRUE(std::isfinite(torque)) << text;
    for (const double distance : model.ClearanceAt(pose))
      ASSERT_FALSE(std::isnan(distance)) << text;
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
  for (int i = 0; i < 8200; ++i)
    absl::StrAppend(&many, "<collision><geometry><sphere radius=\"0.01\"/></geometry></collision>");
  EXPECT_THAT(ChainRefusal(Changed("</geometry></collision>\n  </link>\n  <link name=\"left",
                                   absl::StrCat("</geometry></collision>", many,
                                                "\n  </link>\n  <link name=\"left"))),
              HasSubstr("at most 8192"));
}

}  // namespace
}  // namespace robostress::bridge
