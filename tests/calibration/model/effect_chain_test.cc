#include "calibration/model/effect_chain.h"

#include <gtest/gtest.h>

#include <cmath>

#include "calibration/model/hypothesis.h"

namespace robostress::calibration {
namespace {

TEST(EffectChain, ALinkAngleComesBackFromItsReading) {
  JointModel model;
  model.position_offset = 0.02;
  model.effects = {{FindEffect("encoder_eccentricity").value(), {0.03, -0.05, 2.5}},
                   {FindEffect("encoder_gain").value(), {0.05}},
                   {FindEffect("encoder_offset").value(), {-0.1}}};
  const EffectChain chain(model);
  for (const double q : {-1.5, 0.0, 0.7}) {
    EXPECT_NE(chain.Reading(q), q);
    EXPECT_NEAR(chain.LinkOf(chain.Reading(q)), q, 1e-12);
  }
}

TEST(EffectChain, TheMotorsAngleComesBackFromItsLink) {
  JointModel model;
  model.effects = {{FindEffect("transmission_error").value(), {0.02, -0.03, 0.4}},
                   {FindEffect("backlash").value(), {0.05}}};
  EffectChain chain(model);
  JointMoment moment;
  double before = 0;
  for (const double q : {0.3, 0.9, 0.7}) {  // the gap is taken up forwards, then backwards
    moment.q = q;
    const double link = q + chain.Offset(moment);
    EXPECT_NEAR(chain.MotorOf(link), q, 1e-12);
    const double way = std::copysign(1e-4, q - before);
    EXPECT_NEAR(chain.SpeedRatio(q), 1 + (chain.OffsetAt(q + way) - chain.OffsetAt(q)) / way, 1e-3);
    before = q;
  }
  chain.Reset({});
  EXPECT_NEAR(chain.MotorOf(0.02), 0, 1e-12) << "of the gap before";
}

// Asked ahead, a gap says what it then does: in it the link stays.
TEST(EffectChain, AGapIsAheadWhereItWillBe) {
  JointModel model;
  model.effects = {{FindEffect("backlash").value(), {0.05}}};
  EffectChain chain(model);
  JointMoment moment;
  for (const double q : {0.01, 0.3, 0.25, 0.21, 0.19, 0.5}) {
    const double ahead = chain.OffsetAt(q), copied = chain.Copy().OffsetAt(q);
    moment.q = q;
    const double then = chain.Offset(moment);
    EXPECT_NEAR(ahead, then, 1e-12) << q;
    EXPECT_NEAR(copied, then, 1e-12) << q;
  }
}

TEST(EffectChain, ADriveFollowsNothingBeyondItsLimit) {
  JointModel model;
  EXPECT_EQ(EffectChain(model).DriveSlope(3, {}), 1);
  model.effects = {{FindEffect("motor_gain").value(), {-0.2}},
                   {FindEffect("torque_saturation").value(), {2}}};
  const EffectChain chain(model);
  EXPECT_NEAR(chain.DriveSlope(1, {}), 0.8, 1e-9);
  EXPECT_EQ(chain.DriveSlope(5, {}), 0);
}

TEST(Hypotheses, AnEffectOfTemperatureNeedsOneThatWasLoggedAndChanged) {
  const EffectInfo& effect = *FindEffect("temperature_friction").value();
  SignalScales scales;
  EXPECT_FALSE(IsLogged(effect, scales)) << "none is logged";
  scales.coldest = 22;
  scales.warming = 1;
  EXPECT_FALSE(IsLogged(effect, scales)) << "a step of the sensor";
  scales.warming = 9;
  EXPECT_TRUE(IsLogged(effect, scales));
  EXPECT_EQ(WithEffect({}, effect, scales).front().model.effects[0].values[2], 22) << "T_ref";
}

}  // namespace
}  // namespace robostress::calibration
