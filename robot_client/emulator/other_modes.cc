#include "robot_client/emulator/other_modes.h"

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <algorithm>

namespace robostress::piper {
namespace {

constexpr uint16_t kPoseTargets = 0x152, kArcPoint = 0x158;
constexpr int kIterations = 200;
constexpr double kDamping = 1e-4;       // added to J J^T [m^2], [rad^2]
constexpr double kLargestStep = 0.2;    // [rad] per iteration
constexpr double kLargestError = 1e-4;  // [m], [rad] of a solution

// An unsigned integer of `bits` bits, spread over [lowest, highest].
double Spread(unsigned value, int bits, double lowest, double highest) {
  return lowest + (highest - lowest) * value / static_cast<double>((1u << bits) - 1);
}

}  // namespace

std::optional<JointPair> DecodePoseTarget(const CanFrame& frame) {
  if (frame.id < kPoseTargets || frame.id > kPoseTargets + 2) return std::nullopt;
  CanFrame as_feedback = frame;
  as_feedback.id = static_cast<uint16_t>(kEndPose + (frame.id - kPoseTargets));
  return DecodeEndPose(as_feedback);
}

std::optional<MitTarget> DecodeMitTarget(const CanFrame& frame) {
  if (frame.size != 8 || frame.id < kMitTargets || frame.id > kLastCommand) return std::nullopt;
  const auto& b = frame.data;
  uint8_t check = 0;
  for (int i = 0; i < 7; ++i) check ^= b[i];
  if ((check & 0x0F) != (b[7] & 0x0F)) return std::nullopt;
  MitTarget target;
  target.joint = frame.id - kMitTargets;
  target.position = Spread(b[0] << 8 | b[1], 16, -12.5, 12.5);
  target.velocity = Spread(b[2] << 4 | b[3] >> 4, 12, -45, 45);
  target.kp = Spread((b[3] & 0x0F) << 8 | b[4], 12, 0, 500);
  target.kd = Spread(b[5] << 4 | b[6] >> 4, 12, -5, 5);
  target.feedforward = Spread((b[6] & 0x0F) << 4 | b[7] >> 4, 8, -8, 8);
  return target;
}

std::optional<int> DecodeArcPoint(const CanFrame& frame) {
  if (frame.size != 8 || frame.id != kArcPoint || frame.data[0] < 1 || frame.data[0] > 3)
    return std::nullopt;
  return frame.data[0];
}

Eigen::Matrix3d FromFixedAngles(const Eigen::Vector3d& rpy) {
  return (Eigen::AngleAxisd(rpy[2], Eigen::Vector3d::UnitZ()) *
          Eigen::AngleAxisd(rpy[1], Eigen::Vector3d::UnitY()) *
          Eigen::AngleAxisd(rpy[0], Eigen::Vector3d::UnitX()))
      .toRotationMatrix();
}

std::optional<JointVector> SolvePose(const Eigen::Vector3d& p, const Eigen::Matrix3d& R,
                                     const JointVector& start,
                                     const std::array<Range, kJoints>& limits, Zero zero,
                                     double tolerance) {
  JointVector q = start;
  bool close = false;
  for (int i = 0; i < kIterations; ++i) {
    const Eigen::Isometry3d T = ToolPose(q, zero);
    const Eigen::AngleAxisd turn(R * T.linear().transpose());
    Eigen::Matrix<double, 6, 1> error;
    error << p - T.translation(), turn.angle() * turn.axis();
    const double away = std::max(error.head<3>().norm(), error.tail<3>().norm());
    if (away < tolerance) return q;
    close = away < kLargestError;
    const Eigen::Matrix<double, 6, kJoints> J = ToolJacobian(q, zero);
    Eigen::Matrix<double, 6, 6> A = J * J.transpose();
    A.diagonal().array() += kDamping;
    Eigen::Matrix<double, kJoints, 1> step = J.transpose() * A.ldlt().solve(error);
    step *= std::min(1.0, kLargestStep / (step.cwiseAbs().maxCoeff() + 1e-12));
    for (int j = 0; j < kJoints; ++j)
      q[j] = std::clamp(q[j] + step[j], limits[j].lower, limits[j].upper);
  }
  if (close) return q;
  return std::nullopt;
}

}  // namespace robostress::piper
