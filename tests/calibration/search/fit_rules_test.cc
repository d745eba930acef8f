#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <optional>
#include <vector>

#include "calibration/data/local_polynomial.h"
#include "calibration/search/cross_validation.h"
#include "calibration/search/plausibility.h"
#include "calibration/search/residual_tests.h"
#include "common/random.h"
#include "tests/calibration/search/brief_machine.h"

namespace robostress::calibration {
namespace {

// Noise whose neighbours are correlated by `rho`.
Eigen::VectorXd Correlated(int n, double rho) {
  RandomStream random(StreamKey("fit rules").With(n));
  Eigen::VectorXd x(n);
  double last = random.Normal();
  for (int i = 0; i < n; ++i) {
    x[i] = last;
    last = rho * last + std::sqrt(1 - rho * rho) * random.Normal();
  }
  return x;
}

TEST(CorrelationRows, CountBothSidesOfTheAutocorrelation) {
  EXPECT_EQ(CorrelationRows(Correlated(20000, 0)), 1);
  // 1 + 2 (rho + rho^2 + ...) as far as 0.05.
  double rows = 1;
  for (double rho = 0.8; rho > 0.05; rho *= 0.8) rows += 2 * rho;
  EXPECT_NEAR(CorrelationRows(Correlated(20000, 0.8)), rows, 0.15 * rows);
}

TEST(WithoutLargest, LeavesOutTheTenthWithTheLargestEnergyPerRow) {
  std::vector<double> energy;
  std::vector<int> rows;
  for (int i = 0; i < 20; ++i) {
    energy.push_back(i + 1);
    rows.push_back(10);
  }
  rows[19] = 1000;  // much energy, spread over many rows
  const WindowSet bulk = WithoutLargest(energy, rows);
  for (int i = 0; i < 20; ++i) EXPECT_EQ(bulk[i] != 0, i != 17 && i != 18) << i;
  rows.assign(20, 0);
  const WindowSet none = WithoutLargest(energy, rows);
  EXPECT_EQ(std::count(none.begin(), none.end(), 1), 0);
}

TEST(Compare, IsTheMeanDifferenceAndItsStandardErrorOverWindows) {
  CrossValidation a, b;
  a.rows = b.rows = {10, 10, 10, 10, 0};
  a.energy = {1, 2, 3, 4, 100};
  b.energy = {2, 4, 6, 8, 0};
  const PairedDifference difference = Compare(a, b);
  // Differences 1, 2, 3, 4: their sum has the deviation sqrt(1.25) * 2.
  EXPECT_NEAR(difference.mean, 10.0 / 40, 1e-12);
  EXPECT_NEAR(difference.standard_error, std::sqrt(1.25) * 2 / 40, 1e-12);
}

TEST(LocalPolynomials, AreExactOnAParabolaUpToTheEnds) {
  const double dt = 0.01;
  std::vector<double> signal;
  for (int i = 0; i < 50; ++i) signal.push_back(1 + 2 * i * dt + 3 * i * dt * i * dt);
  const SmoothSignal fit = FitLocalPolynomials(signal, dt, 5, 2, 0, {0, 50});
  for (int i = 0; i < 50; ++i) {
    EXPECT_NEAR(fit.value[i], signal[i], 1e-9);
    EXPECT_NEAR(fit.first[i], 2 + 6 * i * dt, 1e-7);
    EXPECT_NEAR(fit.second[i], 6, 1e-5);
  }
}

TEST(NoiseOfReading, IsTheNoiseBesideAMotion) {
  const Eigen::VectorXd noise = Correlated(4000, 0);
  std::vector<double> signal;
  for (int i = 0; i < 4000; ++i) signal.push_back(std::sin(0.01 * i) + 1e-3 * noise[i]);
  EXPECT_NEAR(NoiseOfReading(signal), 1e-3, 1e-4);
}

class FitRules : public BriefServo {
 protected:
  void SetUp() override {
    BriefServo::SetUp();
    if (HasFatalFailure()) return;
    problem_.emplace(rig_.Problem(0));
    declared_ = *rig_.Declared(0);
  }

  std::optional<JointProblem> problem_;
  Hypothesis declared_;
};

TEST_F(FitRules, AFoldIsPredictedByAFitOfTheOthers) {
  const JointFit fit = Minimise(*problem_, declared_, problem_->OfRole(LogRole::kFit));
  const std::vector<WindowSet> folds = MakeFolds(*problem_, Folds::kBlock);
  ASSERT_EQ(folds.size(), 5u);
  const CrossValidation cv = CrossValidate(*problem_, fit, folds);
  for (size_t f = 0; f < folds.size(); ++f) {
    WindowSet others(problem_->windows().size(), 0);
    for (size_t g = 0; g < folds.size(); ++g)
      for (size_t i = 0; i < others.size(); ++i) others[i] |= g != f && folds[g][i];
    const Eigen::VectorXd x = Minimise(*problem_, fit.best, others, 4, 1e-3).best.x;
    EXPECT_EQ(cv.x[f], x) << f;
  }
  EXPECT_NE(cv.x[0], cv.x[1]);
}

TEST_F(FitRules, NoiseIsWhiteAndWhatGoesOnIsNot) {
  const WindowSet all = problem_->All();
  const int rows = problem_->Rows(all);
  ASSERT_GT(rows, 500);
  EXPECT_TRUE(TestWhiteness(*problem_, Correlated(rows, 0), all).white);
  const WhitenessReport report = TestWhiteness(*problem_, Correlated(rows, 0.5), all);
  EXPECT_FALSE(report.white);
  EXPECT_NEAR(report.autocorrelation, 0.5, 0.1);
}

TEST_F(FitRules, WhatStandsOnABoundHasNoDeviation) {
  const WindowSet fitted = problem_->OfRole(LogRole::kFit);
  JointFit fit = Minimise(*problem_, declared_, fitted);
  ASSERT_FALSE(fit.best.free.empty());
  fit.at_bound.assign(fit.best.free.size(), 0);
  EXPECT_GT(StandardDeviations(*problem_, fit, fitted)[0], 0);
  fit.at_bound[0] = 1;
  EXPECT_EQ(StandardDeviations(*problem_, fit, fitted)[0], 0);
}

TEST_F(FitRules, ADelayTakesThePlaceOfTheFreeShift) {
  const auto is_shift = [](const FreeParameter& p) { return p.path == "command_shift"; };
  ASSERT_TRUE(std::any_of(declared_.free.begin(), declared_.free.end(), is_shift));
  const auto delayed =
      WithEffect(declared_, **FindEffect("transport_delay"), rig_.Scales(0)).front();
  EXPECT_FALSE(std::any_of(delayed.free.begin(), delayed.free.end(), is_shift));
  EXPECT_EQ(delayed.x.size(), static_cast<int>(delayed.free.size()));
  const auto other = WithEffect(declared_, **FindEffect("backlash"), rig_.Scales(0)).front();
  EXPECT_TRUE(std::any_of(other.free.begin(), other.free.end(), is_shift));
}

TEST_F(FitRules, TheFirstOfManyRunsSaysNothing) {
  const std::vector<JointTrack>& tracks = problem_->tracks();
  const int window = tracks[0].log->rows / 10;
  const JointProblem many("hinge", tracks, window);
  JointModel off = declared_.model;
  off.position_offset += 1;
  const std::vector<double> residual = many.TrackResidual(off, 0);
  EXPECT_EQ(std::count(residual.begin(), residual.begin() + window, 0.0), window);
  EXPECT_NE(residual[window], 0);
  const JointProblem few("hinge", tracks, 3 * window), whole("hinge", tracks, 0);
  EXPECT_NE(few.TrackResidual(off, 0)[0], 0);
  EXPECT_NE(whole.TrackResidual(off, 0)[0], 0);
}

TEST(JointProblem, TheZeroBetweenTwoEncodersIsThatOfTheRowsThatAreHeard) {
  generator::RigOptions options;
  options.family = generator::Family::kTransmission;
  options.richness = generator::Richness::kBrief;
  const auto machine = generator::GenerateRig(options);
  ASSERT_TRUE(machine.ok()) << machine.status();
  const std::string folder = testing::TempDir() + "/two_encoders";
  ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder).ok());
  const auto rig = LoadRig(folder + "/rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status();
  const std::vector<JointTrack> tracks = MakeTracks(*rig->plant, rig->logs, 0);
  const JointProblem problem("hinge", tracks, tracks[0].log->rows / 10);
  const JointModel model = rig->Declared(0)->model;
  JointModel off = model;
  off.position_offset += 1;
  const std::vector<double> here = problem.TrackResidual(model, 0),
                            there = problem.TrackResidual(off, 0);
  for (size_t row = 0; row < here.size(); ++row) EXPECT_NEAR(here[row], there[row], 1e-9) << row;
  std::filesystem::remove_all(folder);
}

TEST_F(FitRules, LateParametersAreFreedOfWhatWasAddedOnly) {
  Hypothesis soft = WithEffect(declared_, **FindEffect("compliance"), rig_.Scales(0)).front();
  const auto is_late = [](const FreeParameter& p) {
    return p.path == "compliance.frequency" || p.path == "compliance.zeta";
  };
  EXPECT_EQ(std::count_if(soft.free.begin(), soft.free.end(), is_late), 0);
  EXPECT_EQ(WithLateParameters(soft, {"backlash"}).free.size(), soft.free.size());
  const Hypothesis loose = WithLateParameters(soft, {"compliance"});
  EXPECT_EQ(std::count_if(loose.free.begin(), loose.free.end(), is_late), 2);
  EXPECT_EQ(loose.x.size(), static_cast<int>(loose.free.size()));
  EXPECT_EQ(ModelAt(loose, loose.x).effects.back().values,
            ModelAt(soft, soft.x).effects.back().values);
  EXPECT_EQ(WithLateParameters(loose, {"compliance"}).free.size(), loose.free.size());
}

TEST_F(FitRules, BesideALagTheHoldOfACommandIsFreeOnceMore) {
  const Hypothesis lag = WithEffect(declared_, **FindEffect("servo_lag"), rig_.Scales(0)).front();
  EXPECT_EQ(WithLateParameters(lag, {"transport_delay"}).free.size(), lag.free.size());
  const Hypothesis loose = WithLateParameters(lag, {"servo_lag"});
  ASSERT_EQ(loose.free.size(), lag.free.size() + 1);
  EXPECT_EQ(loose.free.back().path, "command_shift");
  EXPECT_EQ(loose.x.tail(1)[0], 0);
}

TEST_F(FitRules, AFrictionCurveHasNoViscousPartBesideFreeDamping) {
  const auto viscous = [](const Hypothesis& h) {
    return std::count_if(h.free.begin(), h.free.end(), [](const FreeParameter& p) {
      return p.path == "stribeck_friction.sigma_v";
    });
  };
  const EffectInfo& curve = **FindEffect("stribeck_friction");
  Hypothesis h = declared_;
  std::erase_if(h.free, [](const FreeParameter& p) { return p.path == "damping"; });
  h.model.effects.clear();
  h.x = Eigen::VectorXd::Zero(static_cast<Eigen::Index>(h.free.size()));
  EXPECT_EQ(viscous(WithEffect(h, curve, rig_.Scales(0)).front()), 1);
  h.free.push_back({"damping", 1, 0, 20});
  h.x.conservativeResize(h.x.size() + 1);
  h.x[h.x.size() - 1] = 0.3;
  const Hypothesis with = WithEffect(h, curve, rig_.Scales(0)).front();
  EXPECT_EQ(viscous(with), 0);
  EXPECT_EQ(*FindValue(const_cast<JointModel&>(with.model), "stribeck_friction.sigma_v").value(),
            0);
}

TEST_F(FitRules, CommandsGoOnBetweenRowsWhereTheMachineSawThemSo) {
  JointModel machine = declared_.model;
  for (const bool continuous : {true, false}) {
    machine.continuous_command = continuous;
    for (size_t log = 0; log < rig_.logs.size(); ++log) {
      const std::vector<double> off = problem_->TrackResidual(machine, log);
      std::vector<double>& q = rig_.logs[log].joints[0].q;
      for (size_t row = 0; row < q.size(); ++row) q[row] += off[row];
    }
    const WindowSet fitted = problem_->OfRole(LogRole::kFit);
    JointFit fit{.best = declared_};
    fit.best.model.continuous_command = !continuous;
    fit = Minimise(*problem_, fit.best, fitted);
    const JointFit better = WithBetterCommands(*problem_, fit, fitted);
    EXPECT_EQ(better.best.model.continuous_command, continuous);
    EXPECT_LT(better.rms, 0.97 * fit.rms);
    EXPECT_EQ(WithBetterCommands(*problem_, better, fitted).best.model.continuous_command,
              continuous);
  }
}

// A spring's stiffness and the straight part of a polynomial are one torque.
TEST_F(FitRules, OfTwoEffectsThatGiveOneTorqueANeedlessSizeLeaves) {
  Hypothesis h = WithEffect(declared_, **FindEffect("cable_spring"), rig_.Scales(0)).front();
  h = WithEffect(h, **FindEffect("position_dependent_torque"), rig_.Scales(0)).front();
  const auto at = [&](const Hypothesis& in, const std::string& path) {
    for (size_t i = 0; i < in.free.size(); ++i)
      if (in.free[i].path == path) return static_cast<int>(i);
    return -1;
  };
  h.x[at(h, "cable_spring.k")] = 0.2;
  h.x[at(h, "position_dependent_torque.c1")] = -0.2;  // as the spring, against the way
  h.x[at(h, "cable_spring.q0")] = 0.5;
  h.x[at(h, "position_dependent_torque.c2")] = 0.3;
  const JointModel machine = ModelAt(h, h.x);
  for (size_t log = 0; log < rig_.logs.size(); ++log) {
    const std::vector<double> off = problem_->TrackResidual(machine, log);
    std::vector<double>& q = rig_.logs[log].joints[0].q;
    for (size_t row = 0; row < q.size(); ++row)
      q[row] += off[row] + 1e-5 * std::sin(static_cast<double>(row * row));
  }
  const WindowSet fitted = problem_->OfRole(LogRole::kFit);
  const JointFit fit = Minimise(*problem_, h, fitted);
  const JointFit less = DropNeedless(*problem_, fit, "position_dependent_torque", fitted);
  EXPECT_LT(at(less.best, "position_dependent_torque.c1"), 0);
  EXPECT_GE(at(less.best, "position_dependent_torque.c2"), 0);
  EXPECT_LE(less.rms, 1.01 * fit.rms);
  EXPECT_EQ(DropNeedless(*problem_, fit, "cable_spring", fitted).best.free.size(), h.free.size());
}

TEST_F(FitRules, WithoutItsLastParameterAModelIsWhatItIs) {
  Hypothesis one = declared_;
  one.free = {{"frictionloss", 1, 0, 3}};
  one.x = Eigen::VectorXd::Constant(1, 0.5);
  const WindowSet fitted = problem_->OfRole(LogRole::kFit);
  const JointFit fit = Minimise(*problem_, one, fitted);
  const JointFit less = MinimiseWithout(*problem_, fit, FixedAtZero(fit.best, 0), fitted);
  EXPECT_TRUE(less.best.free.empty());
  EXPECT_GE(less.rms, fit.rms);
}

// Friction of an arm's joint that depends on the other one.
TEST(DropIdle, ASizeThatMovesNothingLeaves) {
  generator::RigOptions options;
  options.family = generator::Family::kArm;
  options.richness = generator::Richness::kBrief;
  const auto machine = generator::GenerateRig(options);
  ASSERT_TRUE(machine.ok()) << machine.status();
  const std::string folder = testing::TempDir() + "/idle_arm";
  ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder).ok());
  const auto rig = LoadRig(folder + "/rig.yaml");
  ASSERT_TRUE(rig.ok()) << rig.status();
  const JointProblem problem = rig->Problem(0);
  const WindowSet fitted = problem.OfRole(LogRole::kFit);
  const EffectInfo& effect = **FindEffect("cross_joint_friction");
  Hypothesis h;
  h.model = rig->Declared(0)->model;
  h.model.effects.clear();
  h.model.frictionloss = 0;
  JointFit fit{.best = WithEffect(h, effect, rig->Scales(0), 1).front()};
  ASSERT_EQ(fit.best.free.size(), 3u);
  fit.best.x << 0.02, 0.02, -0.01;  // less than no dry friction
  fit.at_bound.assign(3, 0);
  const JointFit less = DropIdle(problem, fit, effect.type, fitted);
  ASSERT_EQ(less.best.free.size(), 2u);
  EXPECT_EQ(less.best.free[1].path, "cross_joint_friction.d");
  EXPECT_EQ(ModelAt(less.best, less.best.x).effects.back().values[2], 0);
  fit.best.x[2] = 0.01;
  EXPECT_EQ(DropIdle(problem, fit, effect.type, fitted).best.free.size(), 3u);

  // The torque that couples the joints is known to a few percent.
  JointFit coupled{
      .best = WithEffect(h, **FindEffect("cross_joint_inertia"), rig->Scales(0), 1).front()};
  coupled.best.x[0] = 1e-6;
  EXPECT_THAT(PhysicalDoubt(problem, coupled, {0.0}),
              testing::HasSubstr("% of the torque that couples the joints"));
  coupled.best.x[0] = 1;
  EXPECT_EQ(PhysicalDoubt(problem, coupled, {0.0}), "");
  std::filesystem::remove_all(folder);
}

TEST(ScaleOf, GivesEveryParameterItsUnit) {
  SignalScales s;
  s.torque = 6;
  s.position = 2;
  s.velocity = 3;
  EXPECT_EQ(ScaleOf(EffectScale::kTorquePerVelocity, s), 2);
  EXPECT_EQ(ScaleOf(EffectScale::kTorquePerVelocity2, s), 6.0 / 9);
  EXPECT_EQ(ScaleOf(EffectScale::kTorquePerPosition, s), 3);
  EXPECT_EQ(ScaleOf(EffectScale::kTorquePerPosition3, s), 6.0 / 8);
  EXPECT_EQ(ScaleOf(EffectScale::kOne, s), 1);
}

}  // namespace
}  // namespace robostress::calibration
