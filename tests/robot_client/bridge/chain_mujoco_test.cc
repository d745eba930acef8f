// The chain against MuJoCo, which reads the same description by itself.
#include <gtest/gtest.h>
#include <mujoco/mujoco.h>

#include <algorithm>
#include <cmath>
#include <memory>
#include <random>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/models/urdf_model.h"
#include "robot_client/bridge/chain_model.h"
#include "robot_client/capsule.h"
#include "tests/robot_client/bridge/seven_joints.h"

namespace robostress::bridge {
namespace {

struct Mujoco {
  explicit Mujoco(const std::string& urdf) {
    const auto xml = XmlFile::Parse("seven.urdf", urdf);
    EXPECT_TRUE(xml.ok());
    const auto read = ReadUrdf(*xml, SevenNames());
    EXPECT_TRUE(read.ok()) << read.status();
    const std::string path = ::testing::TempDir() + "/chain.urdf";
    EXPECT_TRUE(WriteFileAtomically(path, read->xml).ok());
    char error[500] = "";
    model = mj_loadXML(path.c_str(), nullptr, error, sizeof error);
    EXPECT_NE(model, nullptr) << error;
    model->opt.disableflags |= mjDSBL_CONTACT | mjDSBL_LIMIT;
    data = mj_makeData(model);
  }
  ~Mujoco() {
    mj_deleteData(data);
    mj_deleteModel(model);
  }
  void Set(const ArmVector& q, const ArmVector& v, const ArmVector& a) {
    for (int j = 0; j < 7; ++j) {
      data->qpos[j] = q[j];
      data->qvel[j] = v[j];
      data->qacc[j] = a[j];
    }
    mj_inverse(model, data);
  }
  mjModel* model = nullptr;
  mjData* data = nullptr;
};

TEST(ChainMujoco, TorquesAndPlacesAreThose) {
  const auto chain =
      ReadArmChain("seven.urdf", SevenUrdf(), SevenNames(), SevenLimits(), SevenModel());
  ASSERT_TRUE(chain.ok()) << chain.status();
  const ChainModel ours(*chain, {});
  // The same with a point of 1.5 kg at the tool, which MuJoCo wants to have some inertia.
  const std::string loaded_urdf = absl::StrReplaceAll(
      SevenUrdf(),
      {{"<link name=\"tcp\"/>",
        "<link name=\"tcp\"><inertial><mass value=\"1.5\"/><inertia ixx=\"1e-9\" iyy=\"1e-9\" "
        "izz=\"1e-9\" ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial></link>"}});
  Mujoco empty(SevenUrdf()), loaded(loaded_urdf);
  ASSERT_EQ(empty.model->nv, 7);
  std::mt19937 random(7);
  std::uniform_real_distribution<double> share(-1, 1);
  const int tool = mj_name2id(empty.model, mjOBJ_BODY, "tcp");
  ASSERT_GE(tool, 0);
  for (int k = 0; k < 200; ++k) {
    ArmVector q{}, v{}, a{};
    for (int j = 0; j < 7; ++j) {
      q[j] = 3 * share(random);
      v[j] = 2 * share(random);
      a[j] = 10 * share(random);
    }
    q[7] = 0.04;
    empty.Set(q, v, a);
    loaded.Set(q, v, a);
    const ArmVector torque = ours.Torque(q, v, a, 0), heavy = ours.Torque(q, v, a, 1.5);
    for (int j = 0; j < 7; ++j) {
      // MuJoCo turns inertias into principal axes, to some 1e-10 of their size.
      ASSERT_NEAR(torque[j], empty.data->qfrc_inverse[j], 1e-7) << "J" << j + 1;
      ASSERT_NEAR(heavy[j], loaded.data->qfrc_inverse[j], 1e-6) << "J" << j + 1;
    }
    for (int i = 0; i < 3; ++i)
      ASSERT_NEAR(ours.ToolAt(q)[i], empty.data->xpos[3 * tool + i], 1e-12);
  }
}

// The hand's box and the upper arm's cylinder, sampled where MuJoCo has them: the distance that is
// watched is never more than theirs.
TEST(ChainMujoco, TheArmAgainstItselfIsNeverFurtherThanItIs) {
  auto chain = ReadArmChain("seven.urdf", SevenUrdf(), SevenNames(), SevenLimits(), SevenModel());
  ASSERT_TRUE(chain.ok()) << chain.status();
  ChooseLinkPairs(SevenLimits(), {}, 0, {}, &*chain);
  const ChainModel ours(*chain, {});
  Mujoco arm(SevenUrdf());
  const int hand = mj_name2id(arm.model, mjOBJ_BODY, "hand");
  const int upper = mj_name2id(arm.model, mjOBJ_BODY, "link3");
  std::mt19937 random(11);
  std::uniform_real_distribution<double> share(0, 1);
  int near = 0;
  for (int k = 0; k < 20000; ++k) {
    ArmVector q{};
    for (int j = 0; j < 7; ++j)
      q[j] = SevenLimits().lower[j] +
             share(random) * (SevenLimits().upper[j] - SevenLimits().lower[j]);
    arm.Set(q, {}, {});
    double nearest = 1;
    for (int corner = 0; corner < 8; ++corner) {
      const mjtNum local[3] = {corner & 1 ? 0.02 : -0.02, corner & 2 ? 0.1 : -0.1,
                               corner & 4 ? 0.06 : 0.0};
      mjtNum world[3], in_upper[3];
      mju_rotVecMat(world, local, arm.data->xmat + 9 * hand);
      mju_addTo3(world, arm.data->xpos + 3 * hand);
      mju_subFrom3(world, arm.data->xpos + 3 * upper);
      mju_rotVecMatT(in_upper, world, arm.data->xmat + 9 * upper);
      const double aside = std::max(0.0, std::hypot(in_upper[0], in_upper[1]) - 0.06);
      const double beyond = std::max(0.0, std::abs(in_upper[2] + 0.1) - 0.1);
      nearest = std::min(nearest, std::hypot(aside, beyond));
    }
    const double watched = ours.ClearanceAt(q)[ArmModel::kItself];
    ASSERT_LE(watched, nearest + 1e-9) << "pose " << k;
    near += nearest < 0.1;
  }
  EXPECT_GT(near, 100);
}

// Random capsules and balls, as MuJoCo's own collision finds them.
TEST(ChainMujoco, CapsulesAreAsFarApart) {
  std::mt19937 random(5);
  std::uniform_real_distribution<double> share(-1, 1);
  int compared = 0;
  for (int k = 0; k < 300; ++k) {
    Capsule capsules[2];
    std::string geoms;
    for (Capsule& c : capsules) {
      c.from = {share(random), share(random), share(random)};
      c.to = k % 3 == 0 && &c == &capsules[k % 2]
                 ? c.from
                 : Eigen::Vector3d(share(random), share(random), share(random));
      c.radius = 0.05 + 0.04 * share(random);
      const bool ball = c.from == c.to;
      absl::StrAppend(&geoms, "<body><freejoint/><geom size=\"", c.radius, "\" type=\"",
                      ball ? "sphere" : "capsule", "\" ");
      if (ball) {
        absl::StrAppend(&geoms, "pos=\"", c.from.x(), " ", c.from.y(), " ", c.from.z(), "\"");
      } else {
        absl::StrAppend(&geoms, "fromto=\"", c.from.x(), " ", c.from.y(), " ", c.from.z(), " ",
                        c.to.x(), " ", c.to.y(), " ", c.to.z(), "\"");
      }
      absl::StrAppend(&geoms, " margin=\"5\"/></body>");
    }
    const std::string path = ::testing::TempDir() + "/capsules.xml";
    ASSERT_TRUE(WriteFileAtomically(
                    path, absl::StrCat("<mujoco><worldbody>", geoms, "</worldbody></mujoco>"))
                    .ok());
    char error[500] = "";
    mjModel* model = mj_loadXML(path.c_str(), nullptr, error, sizeof error);
    ASSERT_NE(model, nullptr) << error;
    mjData* data = mj_makeData(model);
    mj_forward(model, data);
    double nearest = 1e9;
    for (int i = 0; i < data->ncon; ++i) nearest = std::min(nearest, data->contact[i].dist);
    if (data->ncon > 0) {
      ++compared;
      EXPECT_NEAR(Distance(capsules[0], capsules[1]), nearest, 1e-5) << geoms;
    }
    mj_deleteData(data);
    mj_deleteModel(model);
  }
  EXPECT_GT(compared, 250);
}

}  // namespace
}  // namespace robostress::bridge
