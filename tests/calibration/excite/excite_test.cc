// Motions of `robostress excite`: within limits, without collision, and worth more than a sweep.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <limits>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "calibration/excite/excitation_design.h"
#include "calibration/model/plant.h"
#include "common/atomic_file.h"
#include "common/random.h"
#include "tests/common/models/mesh_samples.h"

namespace robostress::calibration {
namespace {

using testing::HasSubstr;

// Two links in a plane, upright at 0, with a base that the second one can meet.
constexpr char kTwoLinks[] = R"(<mujoco><compiler angle="radian"/>
<option gravity="0 0 -9.81"/><worldbody>
<body name="base"><geom type="box" size="0.1 0.1 0.05" pos="0 0 -0.1"/>
<body name="upper"><joint name="shoulder" axis="0 1 0" range="-2 2" limited="true" damping="0.5"/>
<geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.03" mass="1"/>
<body name="fore" pos="0 0 0.3"><joint name="elbow" axis="0 1 0" range="-3 3" limited="true"/>
<geom type="capsule" fromto="0 0 0.06 0 0 0.3" size="0.02" mass="0.5"/>
<site name="tip" pos="0 0 0.3"/></body></body></body></worldbody></mujoco>)";

Rig TwoLinks(const std::string& mjcf = kTwoLinks) {
  const std::string folder = ::testing::TempDir() + "robostress_excite";
  std::filesystem::create_directories(folder);
  Rig rig;
  rig.file = folder + "/rig.yaml";
  rig.model = folder + "/model.xml";
  EXPECT_TRUE(WriteFileAtomically(rig.model, mjcf).ok());
  rig.rate_hz = 100;
  for (const char* name : {"shoulder", "elbow"}) {
    RigJoint joint;
    joint.name = name;
    joint.servo.kp = 100;
    joint.servo.kd = 8;
    joint.servo.torque_limit = 30;
    joint.fit = {"damping"};
    rig.joints.push_back(joint);
  }
  return rig;
}

// The same in URDF, the second link a mesh of a package, which MuJoCo does not find.
Rig TwoLinksOfAPackage(bool with_mesh, double effort = 30) {
  const std::string folder = ::testing::TempDir() + "robostress_excite/two_links";
  std::filesystem::remove_all(folder);
  std::filesystem::create_directories(folder + "/urdf");
  std::filesystem::create_directories(folder + "/meshes");
  Rig rig = TwoLinks();
  rig.model = folder + "/urdf/two.urdf";
  if (with_mesh) {
    const std::string mesh = BinaryStl(BoxMesh({-0.02, -0.02, 0.06}, {0.02, 0.02, 0.3}));
    EXPECT_TRUE(WriteFileAtomically(folder + "/meshes/fore.stl", mesh).ok());
  }
  const std::string inertial =
      "<inertial><origin xyz=\"0 0 0.15\"/><mass value=\"1\"/><inertia ixx=\"0.01\" iyy=\"0.01\" "
      "izz=\"0.01\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>";
  const auto joint = [&](const char* name, const char* parent, const char* child, const char* at) {
    return absl::StrCat("<joint name=\"", name, "\" type=\"revolute\"><parent link=\"", parent,
                        "\"/><child link=\"", child, "\"/><origin xyz=\"", at,
                        "\"/><axis xyz=\"0 1 0\"/><limit lower=\"-3\" upper=\"3\" effort=\"",
                        effort, "\" velocity=\"3\"/></joint>");
  };
  EXPECT_TRUE(
      WriteFileAtomically(
          rig.model,
          absl::StrCat(
              "<robot name=\"two\"><link name=\"base\"><collision><origin xyz=\"0 0 -0.1\"/>"
              "<geometry><box size=\"0.2 0.2 0.1\"/></geometry></collision></link>"
              "<link name=\"upper\">",
              inertial,
              "<collision><origin xyz=\"0 0 0.15\"/><geometry><cylinder radius=\"0.03\" "
              "length=\"0.3\"/></geometry></collision></link><link name=\"fore\">",
              inertial,
              "<collision><geometry><mesh filename=\"package://two_links/meshes/fore.stl\"/>"
              "</geometry></collision></link><link name=\"cover\"><collision><geometry><sphere "
              "radius=\"0.03\"/></geometry></collision></link><joint name=\"screws\" "
              "type=\"fixed\">"
              "<parent link=\"fore\"/><child link=\"cover\"/><origin xyz=\"0 0 0.2\"/></joint>",
              joint("shoulder", "base", "upper", "0 0 0"),
              joint("elbow", "upper", "fore", "0 0 0.3"), "</robot>"))
          .ok());
  return rig;
}

TEST(ArmSpaceTest, AUrdfsMeshesAreWatchedWhereverTheirPackageIs) {
  const auto space = ArmSpace::Load(TwoLinksOfAPackage(true), {});
  ASSERT_TRUE(space.ok()) << space.status();
  EXPECT_EQ((*space)->shapes(), 3);
  ASSERT_TRUE((*space)->WatchFrom({0, 0.8}).ok());
  EXPECT_EQ((*space)->MetAt({0, 1.5}), "");
  EXPECT_EQ((*space)->MetAt({0.5, 2.9}), "base and fore");
  const auto bare = ArmSpace::Load(TwoLinksOfAPackage(false), {});
  ASSERT_TRUE(bare.ok()) << bare.status();
  EXPECT_EQ((*bare)->shapes(), 2);
  ASSERT_EQ((*bare)->notes().size(), 1u);
  EXPECT_EQ((*bare)->notes()[0],
            "mesh package://two_links/meshes/fore.stl (not found) is not watched");
}

// Also those of a link that has a shape and no mass.
TEST(ArmSpaceTest, ShapesOfAUrdfChangeNoTorque) {
  const auto with = ArmSpace::Load(TwoLinksOfAPackage(true), {});
  Rig plain = TwoLinks(absl::StrCat(
      "<mujoco><compiler angle=\"radian\"/><worldbody><body name=\"upper\"><inertial pos=\"0 0 "
      "0.15\" mass=\"1\" diaginertia=\"0.01 0.01 0.01\"/><joint name=\"shoulder\" axis=\"0 1 "
      "0\"/><body name=\"fore\" pos=\"0 0 0.3\"><inertial pos=\"0 0 0.15\" mass=\"1\" "
      "diaginertia=\"0.01 0.01 0.01\"/><joint name=\"elbow\" axis=\"0 1 0\"/></body></body>"
      "</worldbody></mujoco>"));
  const auto without = ArmSpace::Load(plain, {});
  ASSERT_TRUE(with.ok() && without.ok());
  const std::vector<double> q = {0.7, -0.4}, v = {1, 2}, a = {-3, 5};
  const std::vector<double> mine = (*with)->TorquesAt(q, v, a),
                            other = (*without)->TorquesAt(q, v, a);
  for (size_t j = 0; j < 2; ++j) EXPECT_NEAR(mine[j], other[j], 1e-5 * std::abs(other[j])) << j;
}

DesignOptions Brief() {
  DesignOptions options;
  options.seconds = 12;
  options.piece_s = 3;
  options.centre = {{"shoulder", 0.5}, {"elbow", 0.8}};
  return options;
}

double Excess(const std::vector<double>& q, const JointRoom& room, double dt) {
  double most = 0;  // times the limit
  for (size_t i = 1; i < q.size(); ++i) {
    most = std::max(most, std::abs(q[i] - q[i - 1]) / dt / room.velocity);
    if (i + 1 < q.size())
      most =
          std::max(most, std::abs(q[i + 1] - 2 * q[i] + q[i - 1]) / (dt * dt) / room.acceleration);
    if (q[i] > room.upper + 1e-9 || q[i] < room.lower - 1e-9) return 1e9;
  }
  return most;
}

TEST(PiecePool, KeepsWithinAnyRoomAndComesBack) {
  RandomStream random(StreamKey("rooms"));
  for (int k = 0; k < 60; ++k) {
    JointRoom room;
    room.centre = random.Uniform(-2, 2);
    room.lower = room.centre - std::pow(10, random.Uniform(-3, 0.5));
    room.upper = room.centre + std::pow(10, random.Uniform(-3, 0.5));
    room.velocity = std::pow(10, random.Uniform(-2, 1));
    room.acceleration = std::pow(10, random.Uniform(-1, 2));
    const double dt = std::pow(10, random.Uniform(-3, -1.3)), fastest = random.Uniform(0.2, 5);
    const int rows = 20 + random.UniformInt(1000);
    for (const JointPiece& piece : PiecePool(fastest)) {
      const std::vector<double> q = SamplePiece(piece, room, dt, rows);
      ASSERT_EQ(q.size(), static_cast<size_t>(rows)) << piece.Name();
      EXPECT_NEAR(q.front(), room.centre, 1e-12) << piece.Name();
      EXPECT_NEAR(q.back(), room.centre, 1e-12) << piece.Name();
      EXPECT_LE(Excess(q, room, dt), 1 + 1e-6) << piece.Name() << " room " << k;
    }
    EXPECT_LE(Excess(SampleSweep(room, fastest, 1, dt, rows), room, dt), 1 + 1e-6);
  }
}

TEST(PiecePool, RampsHaveTheirSpeedAndMovesStop) {
  const JointRoom room{0, -1, 1, 2, 20};
  const auto speed = [&](const JointPiece& piece) {
    const std::vector<double> q = SamplePiece(piece, room, 0.01, 500);
    double most = 0;
    int still = 0;
    for (size_t i = 1; i < q.size(); ++i) {
      most = std::max(most, std::abs(q[i] - q[i - 1]) / 0.01);
      still += q[i] == q[i - 1];
    }
    return std::pair{most, still};
  };
  EXPECT_NEAR(speed({.kind = JointPiece::Kind::kRamps, .speed = 0.2}).first, 0.4, 1e-3);
  const auto [fast, still] = speed({.kind = JointPiece::Kind::kMoves});
  EXPECT_NEAR(fast, 2, 1e-3);
  EXPECT_GT(still, 25);
}

class Sensitivity : public testing::Test {
 protected:
  JointSensitivities Of(const std::vector<std::vector<double>>& asked,
                        std::vector<std::string> effects = {},
                        const std::map<std::string, double>& overrides = {}) {
    std::vector<JointMotionAsked> motions;
    for (const std::vector<double>& q : asked) motions.push_back({q, overrides});
    const Rig rig = TwoLinks();
    const auto plant = Plant::Load(rig);
    EXPECT_TRUE(plant.ok()) << plant.status();
    auto measured = JointSensitivities::Measure(
        rig, **plant, 1,
        {.dt = 0.01, .noise = 1e-4, .centre = {0.5, 0.8}, .effects = std::move(effects)}, motions);
    EXPECT_TRUE(measured.ok()) << measured.status();
    return *std::move(measured);
  }
  const JointRoom room_{0.8, 0.3, 1.3, 2, 10};
  std::vector<double> Ramps() const {
    return SamplePiece({.kind = JointPiece::Kind::kRamps, .speed = 0.5}, room_, 0.01, 300);
  }
};

TEST_F(Sensitivity, OfTwiceTheSameIsTwiceTheProduct) {
  const JointSensitivities once = Of({Ramps()}, {"backlash", "payload"});
  const Eigen::MatrixXd& product = once.products()[0];
  const auto one = once.SightsIn(product), two = once.SightsIn(2 * product);
  ASSERT_EQ(one.size(), 2u);
  for (size_t i = 0; i < 2; ++i) {
    EXPECT_GT(one[i].times_noise, 1);
    EXPECT_NEAR(two[i].times_noise / one[i].times_noise, std::sqrt(2), 1e-6);
  }
  EXPECT_EQ(one[0].rival, 1);
}

TEST_F(Sensitivity, WhatTheFitImitatesIsNotSeen) {
  // A gain of the motor and of what the model lets free: damping is fitted, so viscous friction
  // that is symmetric shows as nothing, and backlash does.
  const JointSensitivities of = Of({Ramps()}, {"stribeck_friction", "backlash"});
  const auto sights = of.SightsIn(of.products()[0]);
  EXPECT_GT(sights[1].times_noise, 10);
}

TEST_F(Sensitivity, RestTellsNothingOfFrictionAndIsRefusedForWhatCannotBeSeen) {
  const std::vector<double> rest(300, 0.8);
  const JointSensitivities of = Of({rest, Ramps()}, {"backlash", "asymmetric_viscous"});
  const auto still = of.SightsIn(of.products()[0]), moving = of.SightsIn(of.products()[1]);
  EXPECT_LT(still[0].times_noise, 0.05 * moving[0].times_noise);
  const Rig rig = TwoLinks();
  const auto plant = Plant::Load(rig);
  const auto refused = JointSensitivities::Measure(
      rig, **plant, 1,
      {.dt = 0.01, .noise = 1e-4, .centre = {0.5, 0.8}, .effects = {"inertia_coupling_x"}},
      {{Ramps(), {}}});
  EXPECT_THAT(std::string(refused.status().message()), HasSubstr("inertia_coupling_x"));
}

TEST(ArmSpaceTest, FindsWhatMeetsAndWhatMotorsHold) {
  const Rig rig = TwoLinks();
  auto space = ArmSpace::Load(rig, {.clearance = 0.01, .floor_z = -0.2});
  ASSERT_TRUE(space.ok()) << space.status();
  EXPECT_EQ((*space)->shapes(), 2);
  ASSERT_TRUE((*space)->WatchFrom({0.5, 0.8}).ok());
  EXPECT_EQ((*space)->MetAt({0.5, 0.8}), "");
  EXPECT_EQ((*space)->MetAt({1.0, 2.93}), "base and fore");          // folded back
  EXPECT_THAT((*space)->MetAt({1.5, 0.9}), HasSubstr("the floor"));  // hanging down
  // Upper arm level: 1 kg at 0.15 m and 0.5 kg at 0.3 + 0.18 m.
  const std::vector<double> torque = (*space)->TorquesAt({M_PI / 2, 0}, {0, 0}, {0, 0});
  EXPECT_NEAR(torque[0], -9.81 * (1 * 0.15 + 0.5 * 0.48), 1e-6);
  // And the model's damping.
  EXPECT_NEAR((*space)->TorquesAt({M_PI / 2, 0}, {0.2, 0}, {0, 0})[0] - torque[0], 0.1, 1e-6);
  // 0.04 m from the base.
  EXPECT_EQ((*space)->MetAt({1.0, 2.45}), "");
  auto wide = ArmSpace::Load(rig, {.clearance = 0.06});
  ASSERT_TRUE((*wide)->WatchFrom({0.5, 0.8}).ok());
  EXPECT_EQ((*wide)->MetAt({1.0, 2.45}), "base and fore");
  auto low = ArmSpace::Load(rig, {.clearance = 0.01, .floor_z = 0.2});
  EXPECT_THAT(std::string((*low)->WatchFrom({0.5, 0.8}).message()), HasSubstr("--floor"));
}

TEST(ArmSpaceTest, MotorsBearWhatTheRigSaysAndTheLoad) {
  Rig rig = TwoLinks();
  const std::vector<double> q = {1.1, -0.6}, v = {0.7, -1.2}, a = {3, -4};
  const auto plain = (*ArmSpace::Load(rig, {}))->TorquesAt(q, v, a);
  rig.joints[0].parameters = {{"armature", 0.4}, {"frictionloss", 1.5}, {"damping", 0.9}};
  const auto declared = (*ArmSpace::Load(rig, {}))->TorquesAt(q, v, a);
  EXPECT_NEAR(declared[0] - plain[0], 0.4 * 3 + 1.5 + (0.9 - 0.5) * 0.7, 1e-6);
  EXPECT_NEAR(declared[1], plain[1], 1e-9);
  rig.joints[0].parameters = {{"mass_scale", 2}};
  const auto heavy = (*ArmSpace::Load(rig, {}))->TorquesAt(q, v, a);
  EXPECT_NEAR(heavy[0] - plain[0], plain[0] - 0.5 * 0.7, 1e-6);
  rig.joints[0].parameters = {{"torque_gain", 0.7}, {"torque_offset", 0.2}};
  EXPECT_NEAR((*ArmSpace::Load(rig, {}))->TorquesAt(q, v, a)[0], (plain[0] - 0.2) / 0.7, 1e-6)
      << "a weak motor is asked for more";
  // A ball at the tip, of the model or as the load.
  std::string with_ball = kTwoLinks;
  const std::string site = "<site name=\"tip\"";
  with_ball.insert(with_ball.find(site),
                   "<body name=\"ball\" pos=\"0 0 0.3\"><inertial pos=\"0 0 0\" mass=\"0.2\" "
                   "diaginertia=\"1e-12 1e-12 1e-12\"/></body>");
  const auto borne = (*ArmSpace::Load(TwoLinks(with_ball), {}))->TorquesAt(q, v, a);
  const auto space = *ArmSpace::Load(TwoLinks(), {});
  space->SetLoad(0.2);
  const auto load = space->TorquesAt(q, v, a);
  for (size_t j = 0; j < 2; ++j) EXPECT_NEAR(load[j], borne[j], 1e-6) << j;
}

// Masks that keep the parts of an arm from each other are for a simulator's speed.
TEST(ArmSpaceTest, PartsMeetWhateverTheirMasks) {
  std::string mjcf = kTwoLinks;
  for (size_t at = 0; (at = mjcf.find("<geom ", at)) != std::string::npos; at += 6)
    mjcf.insert(at + 6, "contype=\"1\" conaffinity=\"0\" ");
  const auto space = ArmSpace::Load(TwoLinks(mjcf), {.clearance = 0.01});
  ASSERT_TRUE((*space)->WatchFrom({0.5, 0.8}).ok());
  EXPECT_EQ((*space)->MetAt({1.0, 2.93}), "base and fore");
}

// Two fingers at the tip, of 50 and 70 g, and a third part of 30 g that follows the right one.
std::string WithFingers(const std::string& equality) {
  std::string mjcf = kTwoLinks;
  mjcf.insert(
      mjcf.find("<site name=\"tip\""),
      "<body name=\"left\" pos=\"0 0.02 0.35\"><joint name=\"left\" type=\"slide\" axis=\"0 1 0\"/>"
      "<geom type=\"box\" size=\"0.01 0.01 0.03\" mass=\"0.05\"/></body>"
      "<body name=\"right\" pos=\"0 -0.02 0.35\"><joint name=\"right\" type=\"slide\" axis=\"0 -1 "
      "0\"/>"
      "<geom type=\"box\" size=\"0.01 0.01 0.03\" mass=\"0.07\"/></body>"
      "<body name=\"pad\" pos=\"0 -0.2 0.35\"><joint name=\"pad\" type=\"slide\" axis=\"0 -1 0\"/>"
      "<geom type=\"box\" size=\"0.01 0.01 0.03\" mass=\"0.03\"/></body>");
  mjcf.insert(mjcf.find("</mujoco>"), "<equality>" + equality + "</equality>");
  return mjcf;
}
constexpr char kFingers[] = "<joint joint1=\"right\" joint2=\"left\" polycoef=\"0.01 2 0 0 0\"/>";
constexpr char kPad[] = "<joint joint1=\"pad\" joint2=\"right\" polycoef=\"0 3 0 0 0\"/>";

// A finger that the rig does not list follows the one that it does, and is borne by its motor:
// whichever the model calls the follower, in whatever order.
TEST(ArmSpaceTest, ACoupledFingerMovesAndWeighsWithItsLeader) {
  const std::vector<double> still = {0, 0, 0};
  for (const std::string listed : {"left", "right"}) {
    for (const std::string& equality :
         {std::string(kFingers) + kPad, std::string(kPad) + kFingers}) {
      Rig rig = TwoLinks(WithFingers(equality));
      rig.joints.push_back(rig.joints[0]);
      rig.joints.back().name = listed;
      const auto space = ArmSpace::Load(rig, {.clearance = 0.002});
      ASSERT_TRUE(space.ok()) << space.status();
      const bool left = listed == "left";
      // right = 0.01 + 2 left, pad = 3 right
      const double open = left ? 0.02 : 0.05, shut = left ? -0.015 : -0.02;
      EXPECT_NEAR((*space)->TorquesAt({0.5, 0.8, open}, still, still)[2], 0, 1e-9)
          << "it lies across gravity";
      const double of_left = 0.05 + 4 * 0.07 + 36 * 0.03;
      EXPECT_NEAR((*space)->TorquesAt({0.5, 0.8, open}, still, {0, 0, 3})[2],
                  3 * (left ? of_left : of_left / 4), 1e-9)
          << listed << equality;
      EXPECT_STREQ((*space)->TorqueUnit(2), "N");
      ASSERT_TRUE((*space)->WatchFrom({0.5, 0.8, open}).ok());
      EXPECT_EQ((*space)->MetAt({0.5, 0.8, open}), "");
      EXPECT_EQ((*space)->MetAt({0.5, 0.8, shut}), "left and right") << "both closed in";
    }
  }
}

TEST(ArmSpaceTest, ALoadIsRoundedDown) {
  EXPECT_DOUBLE_EQ(ArmSpace::RoundLoad(0.295), 0.2);
  EXPECT_DOUBLE_EQ(ArmSpace::RoundLoad(0.3), 0.3);
  EXPECT_DOUBLE_EQ(ArmSpace::RoundLoad(0.149), 0.1);
  EXPECT_DOUBLE_EQ(ArmSpace::RoundLoad(4.9), 4);
  EXPECT_EQ(ArmSpace::RoundLoad(0.004), 0);
}

TEST(ArmSpaceTest, ATurntableOnTheFloorIsNoObstacle) {
  std::string mjcf = kTwoLinks;
  const std::string upper = R"(<body name="upper">)";
  const size_t at = mjcf.find(upper);
  // A plate that turns upright under the arm, 5 mm above the floor.
  mjcf.replace(at, upper.size(),
               R"(<body name="plate"><joint name="turn" axis="0 0 1"/>
<geom type="cylinder" size="0.05 0.005" pos="0 0 -0.04" mass="1"/>)" +
                   upper);
  mjcf.replace(mjcf.find("</body></body></body>"), 7, "</body></body>");
  Rig rig = TwoLinks(mjcf);
  rig.joints.push_back(rig.joints[0]);
  rig.joints.back().name = "turn";
  auto space = ArmSpace::Load(rig, {.clearance = 0.01, .floor_z = -0.08});
  ASSERT_TRUE(space.ok()) << space.status();
  const absl::Status watched = (*space)->WatchFrom({0.3, 0.8, 0});
  EXPECT_TRUE(watched.ok()) << watched;
  EXPECT_THAT((*space)->MetAt({1.5, 0.9, 1}), HasSubstr("the floor"));
}

TEST(Excitation, IsWithinLimitsMeetsNothingAndTellsMoreThanASweep) {
  const Rig rig = TwoLinks();
  DesignOptions options = Brief();
  options.space = {.clearance = 0.01, .floor_z = -0.2};
  const auto design = DesignExcitation(rig, options);
  ASSERT_TRUE(design.ok()) << design.status();
  options.sweep = true;
  const auto sweep = DesignExcitation(rig, options);
  ASSERT_TRUE(sweep.ok()) << sweep.status();
  auto space = ArmSpace::Load(rig, options.space);
  ASSERT_TRUE((*space)->WatchFrom({0.5, 0.8}).ok());
  for (const ExcitationDesign* one : {&*design, &*sweep}) {
    ASSERT_EQ(one->q[0].size(), 1200u);
    for (size_t row = 0; row < 1200; ++row)
      ASSERT_EQ((*space)->MetAt({one->q[0][row], one->q[1][row]}), "") << row;
    for (size_t j = 0; j < 2; ++j) {
      JointRoom room = one->joints[j].room;
      room.velocity = 0.8, room.acceleration = 3;
      EXPECT_LE(Excess(one->q[j], room, 0.01), 1 + 1e-6);
      EXPECT_LE(room.upper - room.lower, 1 + 1e-9);
    }
    EXPECT_LT(one->torque_used, 0.8);
    EXPECT_GT(one->torque_used, 0.05);
  }
  for (size_t j = 0; j < 2; ++j) {
    const auto& sights = design->joints[j].sights;
    double gain = 0;
    for (size_t i = 0; i < sights.size(); ++i)
      gain += std::log((1 + sights[i].times_noise) / (1 + sweep->joints[j].sights[i].times_noise));
    EXPECT_GT(gain / static_cast<double>(sights.size()), std::log(1.2)) << j;
  }
  const std::vector<std::string> lines = absl::StrSplit(ExcitationCsv(*design), '\n');
  EXPECT_EQ(lines[0], "t,q_cmd_shoulder,q_cmd_elbow");
  EXPECT_EQ(lines.size(), 1202u);
}

TEST(Excitation, IsSmallerWhereSomethingIsInTheWay) {
  const Rig rig = TwoLinks();
  DesignOptions options = Brief();
  options.space = {.clearance = 0.01, .floor_z = -0.1};
  options.swing = 1.2;  // hangs down at its end
  const auto design = DesignExcitation(rig, options);
  ASSERT_TRUE(design.ok()) << design.status();
  EXPECT_LT(design->joints[0].room.upper - design->joints[0].room.centre, 1.1);
  EXPECT_THAT(design->notes.front(), HasSubstr("swings are smaller"));
}

std::string Refusal(const Rig& rig, const DesignOptions& options) {
  const auto design = DesignExcitation(rig, options);
  return design.ok() ? "let pass" : std::string(design.status().message());
}

TEST(Excitation, AsksNoMoreThanTheModelsEffortWhereTheRigHasNoLimit) {
  const auto rig_of = [](double effort) {
    Rig rig = TwoLinksOfAPackage(true, effort);
    for (RigJoint& joint : rig.joints)
      joint.servo.torque_limit = std::numeric_limits<double>::infinity();
    return rig;
  };
  DesignOptions options = Brief();
  options.centre = {{"shoulder", 0.3}, {"elbow", 0.8}};
  EXPECT_THAT(Refusal(rig_of(0.05), options), HasSubstr("of 0.05 Nm to hold still"));
  const auto free = DesignExcitation(rig_of(0), options);
  ASSERT_TRUE(free.ok()) << free.status();
  EXPECT_THAT(free->notes, testing::Contains(HasSubstr("torques of shoulder, elbow were not "
                                                       "checked")));
  const auto space = ArmSpace::Load(TwoLinks(), {});
  ASSERT_TRUE(space.ok()) << space.status();
  EXPECT_GT((*space)->LoadOf(0.3, 0.8, {30, 30}, {{0.5, 0.5}}), 0);
  EXPECT_EQ((*space)->LoadOf(0.3, 0.8, {0.05, 30}, {{0.5, 0.5}}), 0);
}

TEST(Excitation, RefusesWhatNoMotionCanMend) {
  Rig rig = TwoLinks();
  rig.joints[0].servo.torque_limit = 1;
  EXPECT_THAT(Refusal(rig, Brief()), HasSubstr("joint 'shoulder' is asked for"));
  EXPECT_THAT(Refusal(rig, Brief()), HasSubstr("to hold still"));
  rig = TwoLinks();
  rig.joints[0].servo.torque_limit = 8;  // holds, but does not speed up as asked
  DesignOptions fast = Brief();
  fast.acceleration = 60, fast.velocity = 6;
  const auto slowed = DesignExcitation(rig, fast);
  ASSERT_TRUE(slowed.ok()) << slowed.status();
  EXPECT_LE(slowed->torque_used, 0.8);
  EXPECT_LT(slowed->joints[0].room.acceleration, 60);
  DesignOptions options = Brief();
  options.centre["shoulder"] = 2.5;
  EXPECT_THAT(Refusal(rig, options), HasSubstr("no room around 2.500 between its stops"));
  options.sweep = true;
  options.centre["shoulder"] = 1.7;  // 0.2 before its stop, as much as is kept
  const auto near = DesignExcitation(TwoLinks(), options);
  ASSERT_TRUE(near.ok()) << near.status();
  EXPECT_LE(near->joints[0].room.upper, 1.8 + 1e-9);
  options = Brief();
  options.velocities["wrist"] = 1;
  EXPECT_THAT(Refusal(rig, options), HasSubstr("no joint 'wrist'"));
  std::string bare = kTwoLinks;
  for (size_t at; (at = bare.find("<geom type=\"capsule\"")) != std::string::npos;)
    bare.replace(at, 6, "<geom contype=\"0\" conaffinity=\"0\" ");
  EXPECT_THAT(Refusal(TwoLinks(bare), Brief()), HasSubstr("--without-shapes"));
}

}  // namespace
}  // namespace robostress::calibration
