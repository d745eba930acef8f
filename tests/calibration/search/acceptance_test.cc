#include "calibration/search/acceptance.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <optional>

#include "tests/calibration/search/brief_machine.h"

namespace robostress::calibration {
namespace {

using testing::HasSubstr;

constexpr double kFloor = 0.01;  // [rad]

// Free runs in four folds with the given error, each of 100 rows.
CrossValidation Errors(double rms, int runs = 20) {
  CrossValidation cv;
  cv.energy.assign(runs, 100 * rms * rms);
  cv.rows.assign(runs, 100);
  cv.fold_rms.assign(4, rms);
  return cv;
}

class AcceptanceTest : public BriefServo {
 protected:
  void SetUp() override {
    BriefServo::SetUp();
    if (HasFatalFailure()) return;
    problem_.emplace(rig_.Problem(0));
    base_.fit.best = *rig_.Declared(0);
    base_.fit.rms = 1;
    base_.cv = Errors(0.04);
    // Explains 15/16 of the energy at a hundredth of the fit's error.
    good_ = base_;
    good_.fit.rms = 0.01;
    good_.cv = Errors(0.0141);
  }

  std::string Objection(const TracedModel& model, double p = 0.001) {
    return Acceptance(*problem_, problem_->OfRole(LogRole::kFit), kFloor)
        .Objection(base_, model, p);
  }

  std::optional<JointProblem> problem_;
  TracedModel base_, good_;
};

TEST_F(AcceptanceTest, TakesWhatPassesEveryGate) { EXPECT_EQ(Objection(good_), ""); }

TEST_F(AcceptanceTest, ExcessIsTheEnergyAboveTheNoise) {
  const Acceptance acceptance(*problem_, problem_->All(), kFloor);
  EXPECT_NEAR(acceptance.Excess(base_), 0.04 * 0.04 - 0.01 * 0.01, 1e-15);
  TracedModel noise = base_;
  noise.cv = Errors(0.009);
  EXPECT_EQ(acceptance.Excess(noise), 0);
}

TEST_F(AcceptanceTest, RefusesWhatChanceExplainsAsWell) {
  good_.cv = Errors(0.0201);
  EXPECT_EQ(Objection(good_, 0.0099), "");
  EXPECT_THAT(Objection(good_, 0.0101), HasSubstr("chance explains as much (p = 0.010)"));
  good_.cv = Errors(0.0199);  // half of the error is no chance
  EXPECT_EQ(Objection(good_, 0.04), "");
}

TEST_F(AcceptanceTest, RefusesWhatIsNoBetterOnRunsThatWereNotFitted) {
  TracedModel model = good_;
  model.cv = Errors(0.04 * 0.985);
  EXPECT_THAT(Objection(model), HasSubstr("the cross-validated error falls by 1.5 % only"));
}

TEST_F(AcceptanceTest, RefusesWhatLeavesThreeQuartersOfTheExcess) {
  // (1 - share) of the excess remains: 24 % and 26 % explained.
  const double excess = 0.04 * 0.04 - kFloor * kFloor;
  TracedModel model = good_;
  model.cv = Errors(std::sqrt(kFloor * kFloor + 0.76 * excess));
  EXPECT_THAT(Objection(model), HasSubstr("it explains 24 % of what is above the noise"));
  model.cv = Errors(std::sqrt(kFloor * kFloor + 0.74 * excess));
  EXPECT_EQ(Objection(model), "");
}

TEST_F(AcceptanceTest, RefusesWhatHelpsInTheWorstTenthOnly) {
  base_.cv.energy[3] *= 40;
  base_.cv.energy[7] *= 40;
  TracedModel model = good_;
  model.cv = base_.cv;
  model.cv.energy[3] = model.cv.energy[7] = model.cv.energy[0];
  model.cv.fold_rms.assign(4, 0.01);
  EXPECT_THAT(Objection(model), HasSubstr("worst tenth of the free runs only"));
}

// As a limit does that few runs reach.
class ActsInATenthOfTheRuns : public AcceptanceTest {
 protected:
  void SetUp() override {
    AcceptanceTest::SetUp();
    base_.cv = good_.cv = Errors(0.04, 80);
    for (int i = 0; i < 8; ++i) base_.cv.energy[10 * i] *= 40;
    good_.cv.fold_rms.assign(4, 0.01);
  }
};

TEST_F(ActsInATenthOfTheRuns, IsTakenWhereNearlyAllOfThemGain) { EXPECT_EQ(Objection(good_), ""); }

TEST_F(ActsInATenthOfTheRuns, IsRefusedWhereSomeAreSetRightAndOthersWrong) {
  good_.cv.energy[5] *= 20;
  good_.cv.energy[15] *= 20;
  EXPECT_THAT(Objection(good_), HasSubstr("not in nearly all of those"));
}

TEST_F(ActsInATenthOfTheRuns, IsRefusedWhereTheOthersLose) {
  for (double& energy : good_.cv.energy) energy *= 1.1;
  EXPECT_THAT(Objection(good_), HasSubstr("worst tenth of the free runs only"));
}

TEST_F(AcceptanceTest, AsksNoTenthOfAFewLongRuns) {
  base_.cv = good_.cv = Errors(0.04, 12);
  base_.cv.energy[3] *= 20;
  good_.cv.fold_rms.assign(4, 0.01);
  EXPECT_EQ(Objection(good_), "");
}

// Damping that is free stands in for the viscous part of a friction curve, and not for the dry one.
TEST_F(AcceptanceTest, TellsAnEffectByTheSizeThatIsKnownBest) {
  Hypothesis h = *rig_.Declared(0);
  h.free.clear();
  h.x.resize(0);
  h.model.effects.clear();
  h.model.frictionloss = h.model.damping = 0;
  h = WithEffect(h, **FindEffect("stribeck_friction"), rig_.Scales(0)).front();
  const auto free = [&](const std::string& path) {
    return std::find_if(h.free.begin(), h.free.end(),
                        [&](const FreeParameter& p) { return p.path == path; }) -
           h.free.begin();
  };
  const auto viscous = free("stribeck_friction.sigma_v");
  ASSERT_LT(viscous, static_cast<std::ptrdiff_t>(h.free.size()));
  FreeParameter damping = h.free[viscous];
  damping.path = "damping";
  h.x[viscous] = 0.3;
  h.free.push_back(damping);
  h.x.conservativeResize(h.x.size() + 1);
  h.x[h.x.size() - 1] = 0.3;
  good_.fit = Minimise(*problem_, h, problem_->OfRole(LogRole::kFit));
  good_.fit.rms = 0.01;
  good_.fit.best.x[viscous] += 5;  // the same motion
  good_.fit.best.x.tail(1)[0] -= 5;
  good_.added = {"stribeck_friction"};
  good_.cv.x = {good_.fit.best.x, good_.fit.best.x};
  EXPECT_EQ(Objection(good_), "");
  good_.cv.x.back()[free("stribeck_friction.Fc")] *= -1;
  good_.cv.x.back()[free("stribeck_friction.Fs")] *= -1;
  EXPECT_THAT(Objection(good_), HasSubstr("differs over the folds"));
}

TEST_F(AcceptanceTest, RefusesWhatHalfOfTheFoldsDoWithout) {
  TracedModel model = good_;
  model.cv.fold_rms = {0.01, 0.01, 0.05, 0.05};
  EXPECT_THAT(Objection(model), HasSubstr("only 2 of 4 folds gain"));
  model.cv.fold_rms = {0.01, 0.01, 0.01, 0.05};
  EXPECT_EQ(Objection(model), "");
}

TEST_F(AcceptanceTest, RefusesAFitThatIsHardlyBetterForItsParameters) {
  TracedModel model = good_;
  model.fit.rms = 1;
  EXPECT_THAT(Objection(model), HasSubstr("BIC falls by"));
}

}  // namespace
}  // namespace robostress::calibration
