#include "calibration/search/aided_motion.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/calibration/search/brief_machine.h"

namespace robostress::calibration {
namespace {

class AidedArm : public BriefMachine {
 protected:
  AidedArm() : BriefMachine(generator::Family::kArm, 1) {}
  void SetUp() override {
    BriefMachine::SetUp();
    ASSERT_FALSE(HasFatalFailure());
    ASSERT_TRUE(AidArmMotions(rig_.rig, *rig_.plant, rig_.logs).ok());
  }
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
