// The chain against MuJoCo, which reads the same description by itself.
#include <gtest/gtest.h>
#include <mujoco/mujoco.h>

#include <memory>
#include <random>
#include <string>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "common/atomic_file.h"
#include "common/models/urdf_model.h"
#include "robot_client/bridge/chain_model.h"
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

}  // namespace
}  // namespace robostress::bridge
