#include "calibration/search/metric_fit.h"

#include <gtest/gtest.h>

#include <filesystem>

#include "calibration/search/subplex.h"
#include "common/atomic_file.h"
#include "tests/calibration/search/brief_machine.h"

namespace robostress::calibration {
namespace {

FreeParameter Between(double lower, double upper) { return {"", 1, lower, upper, false}; }

TEST(Subplex, FindsAMinimumThatHasNoGradientAndStaysWithinBounds) {
  const auto error = [](const Eigen::VectorXd& x) {
    return std::abs(x[0] - 0.3) + 2 * std::abs(x[1] + 0.2) + std::abs(x[2] - 5);
  };
  const SubplexMinimum found = Subplex(error, {Between(-1, 1), Between(-1, 1), Between(0, 2)},
                                       Eigen::Vector3d(0.9, 0.9, 7), 2000);
  EXPECT_NEAR(found.x[0], 0.3, 1e-3);
  EXPECT_NEAR(found.x[1], -0.2, 1e-3);
  EXPECT_NEAR(found.x[2], 2, 1e-3);
  EXPECT_NEAR(found.value, error(found.x), 1e-12);
}

class MetricFitTest : public BriefServo {
 protected:
};

TEST_F(MetricFitTest, WhatIsBestForTheMeanAbsoluteErrorIsNoWorseThanWhatLeastSquaresFinds) {
  const JointProblem problem = rig_.Problem(0);
  const auto declared = rig_.Declared(0);
  ASSERT_TRUE(declared.ok()) << declared.status();
  Metric metric;
  metric.type = Metric::Type::kMeanAbsolute;
  const int window = problem.windows().front().rows;
  const MetricFit absolute(metric, problem, window);
  const MetricFit squares(Metric{}, problem, window);
  EXPECT_TRUE(absolute.own());
  EXPECT_FALSE(squares.own());
  const auto error = [&](const Hypothesis& h) {
    return absolute.Error(ModelAt(h, h.x), LogRole::kFit);
  };
  const Hypothesis best = absolute.Best(*declared);
  EXPECT_LE(error(best), error(squares.Best(*declared)) * (1 + 1e-9));
  EXPECT_LT(error(best), error(*declared));
  // Left out, an error is about as large where nothing is missing.
  EXPECT_GT(absolute.LeftOut(*declared, Folds::kLog), 0.8 * error(best));
  EXPECT_LT(absolute.LeftOut(*declared, Folds::kLog), 1.5 * error(best));
}

TEST_F(MetricFitTest, ARigKeepsItsMetric) {
  rig_.rig.metric.type = Metric::Type::kMeanAbsolute;
  const std::string file = folder_ + "/after.yaml";
  ASSERT_TRUE(WriteFileAtomically(file, WriteRig(rig_.rig)).ok());
  const auto again = ReadRig(file);
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(again->metric.type, Metric::Type::kMeanAbsolute);
}

}  // namespace
}  // namespace robostress::calibration
