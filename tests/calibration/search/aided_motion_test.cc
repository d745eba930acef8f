#include "calibration/search/aided_motion.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>

#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {
namespace {

class AidedArm : public testing::Test {
 protected:
  void SetUp() override {
    generator::RigOptions options;
    options.family = generator::Family::kArm;
    options.richness = generator::Richness::kBrief;
    const auto machine = generator::GenerateRig(options);
    ASSERT_TRUE(machine.ok()) << machine.status();
    folder_ = testing::TempDir() + "/aided_arm";
    ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder_).ok());
    auto rig = LoadRig(folder_ + "/rig.yaml");
    ASSERT_TRUE(rig.ok()) << rig.status();
    rig_ = *std::move(rig);
    ASSERT_TRUE(AidArmMotions(rig_.rig, *rig_.plant, rig_.logs).ok());
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::string folder_;
  LoadedRig rig_;
};

// The way of a row is that of a velocity that begins and ends as said and of an acceleration that
// rises as said: q' - q = T (v + v') / 2 - T^2 r / 12.
TEST_F(AidedArm, AccelerationsRiseWithinARowAsPositionsAsk) {
  const double T = rig_.logs[0].dt;
  double missed = 0, without = 0;
  for (const JointRecord& joint : rig_.logs[0].joints) {
    const JointMotion& m = joint.motion;
    ASSERT_EQ(m.rise.size(), m.q.size());
    for (size_t k = 0; k + 1 < m.q.size(); ++k) {
      const double way = 0.5 * T * (m.dq[k] + m.dq[k + 1]) - (m.q[k + 1] - m.q[k]);
      missed += std::pow(way - T * T * m.rise[k] / 12, 2);
      without += way * way;
    }
  }
  EXPECT_LT(missed, 0.1 * without);
}

// A row's coupling goes with the other joint's acceleration, within the row as from row to row.
TEST_F(AidedArm, TheOtherJointPushesMoreWhereItsAccelerationRises) {
  MeasuredLog log = rig_.logs[0];
  const std::vector<PlantRow> rows = rig_.plant->Rows(1, log);
  for (double& ddq : log.joints[0].motion.ddq) ddq += 1;
  const std::vector<PlantRow> faster = rig_.plant->Rows(1, log);
  log = rig_.logs[0];
  for (double& rise : log.joints[0].motion.rise) rise += 1;
  const std::vector<PlantRow> rising = rig_.plant->Rows(1, log);
  for (size_t k = 0; k + 1 < rows.size(); ++k) {
    const double inertia = faster[k].coupling - rows[k].coupling;
    EXPECT_NEAR(rising[k].coupling_rise - rows[k].coupling_rise, inertia,
                0.05 * std::abs(inertia) + 1e-6)
        << k;
    EXPECT_EQ(rising[k].coupling, rows[k].coupling);
  }
}

}  // namespace
}  // namespace robostress::calibration
