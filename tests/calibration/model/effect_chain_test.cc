#include "calibration/model/effect_chain.h"

#include <gtest/gtest.h>

namespace robostress::calibration {
namespace {

TEST(EffectChain, ALinkAngleComesBackFromItsReading) {
  JointModel model;
  model.position_offset = 0.02;
  model.effects = {{FindEffect("encoder_gain").value(), {0.05}},
                   {FindEffect("encoder_offset").value(), {-0.1}}};
  const EffectChain chain(model);
  for (const double q : {-1.5, 0.0, 0.7}) {
    EXPECT_NE(chain.Reading(q), q);
    EXPECT_NEAR(chain.LinkOf(chain.Reading(q)), q, 1e-12);
  }
}

}  // namespace
}  // namespace robostress::calibration
