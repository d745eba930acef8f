#include "calibration/search/plausibility.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>

#include "tests/calibration/search/brief_machine.h"

namespace robostress::calibration {
namespace {

using testing::HasSubstr;
using testing::StartsWith;

// A generated servo whose model rubs as the test says.
class Plausibility : public BriefServo {
 protected:
  void SetUp() override {
    BriefServo::SetUp();
    if (HasFatalFailure()) return;
    problem_.emplace(rig_.Problem(0));
    fit_.best = *rig_.Declared(0);
    fit_.best.model.effects.clear();
    fit_.best.free.clear();
    fit_.best.x.resize(0);
    fit_.best.model.damping = 0;
    fit_.best.model.frictionloss = 1;
  }
  // With its parameters free.
  void Add(const std::string& type, const std::vector<double>& values) {
    const EffectInfo& info = **FindEffect(type);
    fit_.best.model.effects.push_back({&info, values});
    for (size_t i = 0; i < values.size(); ++i) {
      fit_.best.free.push_back({type + "." + info.parameters[i].name, 1, info.parameters[i].lower,
                                info.parameters[i].upper});
      fit_.best.x.conservativeResize(fit_.best.x.size() + 1);
      fit_.best.x[fit_.best.x.size() - 1] = values[i];
    }
    fit_.at_bound.assign(fit_.best.free.size(), 0);
    std_.assign(fit_.best.free.size(), 0.001);
  }
  std::string Physical() { return PhysicalDoubt(*problem_, fit_, std_); }

  std::optional<JointProblem> problem_;
  JointFit fit_;
  std::vector<double> std_;
};

TEST_F(Plausibility, FrictionThatWouldDriveTheJointOneWayIsDoubted) {
  Add("asymmetric_coulomb", {0.9});
  EXPECT_EQ(Physical(), "");
  fit_.best.x[0] = 1.3;
  EXPECT_THAT(Physical(), HasSubstr("friction would be -0.3 at"));
  EXPECT_THAT(Physical(), HasSubstr("backwards"));
  fit_.best.x[0] = -1.3;
  EXPECT_THAT(Physical(), HasSubstr("forwards"));
  std_[0] = 0.2;  // two standard errors reach that far
  EXPECT_EQ(Physical(), "");
}

TEST_F(Plausibility, ViscousFrictionCountsAtTheSpeedsThatWereReached) {
  fit_.best.model.frictionloss = 0;
  fit_.best.model.damping = 0.2;
  Add("asymmetric_viscous", {0.15});
  EXPECT_EQ(Physical(), "");
  fit_.best.x[0] = 0.4;
  EXPECT_THAT(Physical(), HasSubstr("friction would be -"));
  std_[0] = 0.1;  // the data hardly say it
  EXPECT_EQ(Physical(), "");
}

TEST_F(Plausibility, AWaveOfFrictionMayNotExceedWhatItIsTakenFrom) {
  Add("position_dependent_friction", {0.5, 0, 0.3});
  EXPECT_EQ(Physical(), "");
  fit_.best.x[0] = 1.5;
  EXPECT_THAT(Physical(), HasSubstr("no joint is driven by its friction"));
}

TEST_F(Plausibility, FrictionOfTemperatureAndOfGravityCountsAtWhatWasReached) {
  Add("temperature_friction", {-0.03, 0, 20, 40});  // 40 deg C where nobody measured
  EXPECT_EQ(Physical(), "");
  fit_.best.x[0] = -0.08;
  EXPECT_THAT(Physical(), StartsWith("friction would be -0.6 at"));
  fit_.best.x[0] = 0;
  EXPECT_EQ(Physical(), "");
  Add("gravity_dependent_friction", {-10});  // no fit may go there
  EXPECT_THAT(Physical(), StartsWith("friction would be -"));
}

TEST_F(Plausibility, ADriveThatFadesToNothingIsDoubted) {
  Add("time_varying_gain", {-0.01});
  EXPECT_EQ(Physical(), "");
  fit_.best.x[0] = -0.11;  // of a log of 8 s
  EXPECT_THAT(Physical(), StartsWith("the drive would fade to 12 %"));
}

TEST_F(Plausibility, AParameterOnABoundOrWithoutAStandardErrorIsDoubted) {
  Add("position_periodic_torque", {0.1, 0.1, 0.3});
  EXPECT_EQ(ParameterDoubt(fit_, std_, "position_periodic_torque"), "");
  fit_.at_bound[2] = 1;
  EXPECT_EQ(ParameterDoubt(fit_, std_, "position_periodic_torque"),
            "position_periodic_torque.wavelength is on a bound, 0.3");
  fit_.at_bound[2] = 0;
  std_[2] = 0;
  EXPECT_THAT(ParameterDoubt(fit_, std_, "position_periodic_torque"),
              HasSubstr("wavelength, 0.3, has no standard error"));
  EXPECT_EQ(ParameterDoubt(fit_, std_, "backlash"), "");
}

TEST_F(Plausibility, APartThatIsAbsentIsNoDoubt) {
  Add("stribeck_friction", {0.5, 0.8, 0.1, 0});
  fit_.at_bound[3] = 1;
  std_[3] = 0;
  EXPECT_EQ(ParameterDoubt(fit_, std_, "stribeck_friction"), "");  // sigma_v
  fit_.best.x[2] = 0;
  fit_.at_bound[2] = 1;
  EXPECT_THAT(ParameterDoubt(fit_, std_, "stribeck_friction"), HasSubstr("vs is on a bound"));
  fit_.best.x[1] = 0.4;  // below Fc: there is no curve, and vs says nothing
  EXPECT_EQ(ParameterDoubt(fit_, std_, "stribeck_friction"), "");
}

TEST_F(Plausibility, ARangeThatStopsShortIsWidened) {
  Hypothesis h = *rig_.Declared(0);
  h = WithEffect(h, **FindEffect("gravity_error"), rig_.Scales(0)).front();
  const WindowSet fitted = problem_->OfRole(LogRole::kFit);
  const int beta = static_cast<int>(h.free.size()) - 1;
  h.model.mass_scale = 0.7;  // what gravity_error has to make up for
  h.free[beta].lower = -0.02;
  h.free[beta].upper = 0.02;
  const JointFit narrow = Minimise(*problem_, h, fitted);
  ASSERT_TRUE(narrow.at_bound[beta]);
  const JointFit wide = Widen(*problem_, narrow, fitted);
  EXPECT_GT(std::abs(wide.best.x[beta]), 0.02);
  EXPECT_LT(wide.rms, 0.98 * narrow.rms);
}

}  // namespace
}  // namespace robostress::calibration
