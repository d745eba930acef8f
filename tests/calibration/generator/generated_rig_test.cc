#include "tests/calibration/generator/generated_rig.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

namespace robostress::generator {
namespace {

GeneratedRig Hiding(const std::vector<std::string>& effects, uint64_t seed) {
  RigOptions options;
  options.effects = effects;
  options.seed = seed;
  options.richness = Richness::kBrief;
  const auto rig = GenerateRig(options);
  EXPECT_TRUE(rig.ok()) << rig.status();
  return rig.ok() ? *rig : GeneratedRig{};
}

// What comes behind another effect is there as well.
TEST(GeneratedRig, ADelayBehindAnotherEffectIsSeen) {
  for (const char* before : {"backlash", "compliance", "servo_lag", "rate_limit"}) {
    const GeneratedRig pair = Hiding({before, "transport_delay"}, 801);
    ASSERT_EQ(pair.visibility_of.size(), 2U);
    EXPECT_GT(pair.visibility_of[0], 3) << before;
    EXPECT_GT(pair.visibility_of[1], 3) << before;
  }
}

// No joint is driven by its friction, by that of two effects neither.
TEST(GeneratedRig, EffectsThatTakeFrictionLeaveSomeTogether) {
  for (uint64_t seed = 1; seed <= 8; ++seed) {
    const GeneratedRig pair = Hiding({"asymmetric_coulomb", "asymmetric_viscous"}, seed);
    const double dry = pair.truth.effects.at(0)["dFc"], viscous = pair.truth.effects[1]["d_sigma"];
    for (const double sign : {1.0, -1.0}) {
      const Drive& drive = pair.truth.drives[pair.truth.effects[0].joint];
      // The fastest that any log has, as a bound.
      double fastest = 0;
      for (const GeneratedRig::Log& log : pair.logs) {
        const std::vector<double>& q =
            log.recording.joints[static_cast<size_t>(pair.truth.effects[0].joint)].clean;
        for (size_t k = 1; k < q.size(); ++k)
          fastest = std::max(fastest, std::abs(q[k] - q[k - 1]) * pair.rate_hz);
      }
      EXPECT_GE(drive.Fc + sign * dry + (drive.viscous + sign * viscous) * fastest, 0) << seed;
    }
  }
}

// What a joint's friction is said to be is true, or within reach of its own `fit`.
TEST(GeneratedRig, SaysOfEachJointsFrictionWhatMayMove) {
  int different = 0;
  for (uint64_t seed = 1; seed <= 12; ++seed) {
    RigOptions options;
    options.family = Family::kArm;
    options.richness = Richness::kBrief;
    options.seed = seed;
    const auto rig = GenerateRig(options);
    ASSERT_TRUE(rig.ok()) << rig.status();
    if (!rig->declares_dry_friction) continue;
    different += rig->friction_fit[0] != rig->friction_fit[1];
    for (int j = 0; j < 2; ++j) {
      const Drive &is = rig->truth.drives[j], &said = rig->declared.drives[j];
      const auto moves = [&](const char* name) {
        return std::count(rig->friction_fit[j].begin(), rig->friction_fit[j].end(), name) > 0;
      };
      EXPECT_TRUE(moves("Fs") || said.Fs == is.Fs) << seed;
      EXPECT_TRUE(moves("vs") || said.vs == is.vs) << seed;
    }
  }
  EXPECT_GT(different, 0);
}

}  // namespace
}  // namespace robostress::generator
