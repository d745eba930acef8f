#include "calibration/fidelity/fidelity_intervals.h"

#include <cmath>

#include "calibration/fidelity/dtw.h"
#include "gtest/gtest.h"

namespace robostress::calibration {
namespace {

Profile Step(double before, double after) {
  Profile profile(kPhases);
  for (int i = 0; i < kPhases; ++i) profile[i] = PhaseAt(i) < 0 ? before : after;
  return profile;
}

FidelityResult MakeResult(int layouts) {
  FidelityResult result;
  result.measured.loaded = {Step(0, 6), Step(0, 7), Step(0, 8)};
  result.measured_mean = Mean(result.measured.loaded);
  result.contenders.resize(2);
  for (int i = 0; i < layouts; ++i) {
    result.contenders[0].profiles.push_back(Step(0, 6 + i % 3));
    result.contenders[1].profiles.push_back(Step(8 + i % 3, 9));
  }
  for (Contender& c : result.contenders) c.mean = Mean(c.profiles);
  return result;
}

TEST(AddIntervals, HoldTheirEstimatesAndSetApartWhatIsApart) {
  FidelityResult result = MakeResult(9);
  AddIntervals(500, 1, result);
  const Contender &model = result.contenders[0], &noise = result.contenders[1];
  EXPECT_DOUBLE_EQ(model.dtw.value, DtwDistance(model.mean, result.measured_mean).per_step);
  EXPECT_LE(model.dtw.interval.low, model.dtw.value);
  EXPECT_GE(model.dtw.interval.high, model.dtw.value);
  EXPECT_NEAR(model.rise.value, 7, 1e-9);
  EXPECT_NEAR(noise.rise.value, 0, 1e-9);
  EXPECT_GT(noise.dtw_excess.interval.low, 0);
  EXPECT_NEAR(result.measured_rise.value, 7, 1e-9);
  EXPECT_DOUBLE_EQ(result.measured_rise.interval.low, 6);  // all three draws the lowest: 1 in 27
}

TEST(AddIntervals, DependOnTheSeedAlone) {
  FidelityResult a = MakeResult(9), b = MakeResult(9);
  AddIntervals(200, 1, a);
  AddIntervals(200, 1, b);
  EXPECT_EQ(a.contenders[1].dtw.interval.low, b.contenders[1].dtw.interval.low);
}

TEST(AddIntervals, OfASingleLayoutAreNone) {
  FidelityResult result = MakeResult(1);
  AddIntervals(200, 1, result);
  EXPECT_TRUE(std::isnan(result.contenders[0].dtw.interval.low));
  EXPECT_GT(result.contenders[1].dtw.value, 0);
}

}  // namespace
}  // namespace robostress::calibration
