#include "common/so3.h"

#include <cmath>
#include <numbers>

#include "common/random.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using Eigen::Vector3d;

Vector3d RandomAxis(RandomStream& stream) {
  return Vector3d(stream.Normal(), stream.Normal(), stream.Normal()).normalized();
}

// Rodrigues' formula, independent of quaternions.
Eigen::Matrix3d Rodrigues(const Vector3d& axis, double angle) {
  Eigen::Matrix3d K;
  K << 0, -axis.z(), axis.y(), axis.z(), 0, -axis.x(), -axis.y(), axis.x(), 0;
  return Eigen::Matrix3d::Identity() + std::sin(angle) * K + (1 - std::cos(angle)) * K * K;
}

TEST(So3, ExpAgreesWithRodrigues) {
  RandomStream stream{StreamKey("so3")};
  for (int i = 0; i < 200; ++i) {
    const Vector3d axis = RandomAxis(stream);
    const double angle = stream.Uniform(0, 2 * std::numbers::pi);
    EXPECT_LT((ExpSo3(angle * axis).toRotationMatrix() - Rodrigues(axis, angle)).norm(), 1e-14);
  }
}

TEST(So3, LogInvertsExpForEveryMagnitudeBelowAHalfTurn) {
  RandomStream stream{StreamKey("so3 log")};
  for (const double angle :
       {0.0, 1e-12, 1e-8, 9.9e-7, 1.1e-6, 1e-3, 1.0, 3.0, 3.14, std::numbers::pi - 1e-6}) {
    const Vector3d omega = angle * RandomAxis(stream);
    EXPECT_LT((LogSo3(ExpSo3(omega)) - omega).norm(), 1e-9) << angle;
  }
}

TEST(So3, LogTakesTheShortPathBeyondAHalfTurn) {
  const Vector3d omega = LogSo3(ExpSo3(Vector3d(0, 0, 1.5 * std::numbers::pi)));
  EXPECT_NEAR(omega.z(), -0.5 * std::numbers::pi, 1e-12);
}

TEST(So3, LogIsTheSameForBothSignsOfAQuaternion) {
  const Eigen::Quaterniond q = ExpSo3(Vector3d(0.4, -1.2, 2.1));
  Eigen::Quaterniond negative = q;
  negative.coeffs() = -q.coeffs();
  EXPECT_LT((LogSo3(q) - LogSo3(negative)).norm(), 1e-14);
}

TEST(So3, LogAtExactlyAHalfTurnPicksTheCanonicalAxis) {
  for (const Vector3d& axis :
       {Vector3d(1, 0, 0), Vector3d(0, 1, 0), Vector3d(0, 0, 1), Vector3d(0, 0.6, -0.8)}) {
    for (const double sign : {1.0, -1.0}) {
      const Eigen::Quaterniond q(0, sign * axis.x(), sign * axis.y(), sign * axis.z());
      EXPECT_LT((LogSo3(q) - std::numbers::pi * axis).norm(), 1e-12);
    }
  }
}

TEST(So3, LogOfAMatrixNearAHalfTurnKeepsTheAngle) {
  const Vector3d axis = Vector3d(1, 2, -2).normalized();
  EXPECT_NEAR(LogSo3(Rodrigues(axis, std::numbers::pi - 1e-7)).norm(), std::numbers::pi - 1e-7,
              1e-9);
}

TEST(So3, RotationBetweenIsInTheWorldFrame) {
  const Eigen::Quaterniond from = ExpSo3(Vector3d(0.3, 0.2, -1.0));
  const Vector3d delta(0.1, -0.05, 0.2);
  EXPECT_LT((RotationBetween(from, ExpSo3(delta) * from) - delta).norm(), 1e-14);
}

}  // namespace
}  // namespace robostress
