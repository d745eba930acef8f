#include "robot_client/motion/motion.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "robot_client/motion/excitation.h"
#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/piper_model.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
constexpr double kPeriod = 1.0 / 30;

ArmLimits Limits() {
  ArmLimits limits;
  for (int j = 0; j < piper::kJoints; ++j) {
    limits.lower[j] = piper::kJointRanges[j].lower;
    limits.upper[j] = piper::kJointRanges[j].upper;
  }
  limits.upper[piper::kJoints] = 0.07;
  limits.max_velocity.fill(3);
  limits.max_acceleration.fill(5);
  return limits;
}

// J1 swings by `swing` in a second and back; at `rate` poses a second.
Motion Swing(double swing, double rate = 50) {
  Motion motion;
  motion.source = "swing";
  motion.moves[0] = true;
  for (int i = 0; i <= static_cast<int>(2 * rate); ++i) {
    motion.t.push_back(i / rate);
    motion.poses.push_back({0.5 * swing * (1 - std::cos(M_PI * i / rate))});
  }
  return motion;
}

TEST(MotionTest, GoesToTheFirstPoseSlowlyThenPlaysTheMotionAsItIs) {
  Motion motion = Swing(0.3);
  for (ArmVector& pose : motion.poses) pose[0] += 0.2;
  const ArmVector from = {-0.4, 1.1, -0.9, 0.1, 0.2, 0.3, 0.02};
  PathLimits approach;
  approach.joint_velocity = 0.2;
  const PlayedMotion played = PlayMotion(motion, 1, from, approach, kPeriod);
  const std::vector<ArmVector>& rows = played.path.rows;
  ASSERT_GT(played.first_row, 15u);
  double fastest = std::abs(rows[0][0] - from[0]) / kPeriod;
  for (size_t i = 1; i < played.first_row; ++i)
    fastest = std::max(fastest, std::abs(rows[i][0] - rows[i - 1][0]) / kPeriod);
  EXPECT_LE(fastest, 0.2 + 1e-9);
  EXPECT_GE(fastest, 0.15);
  EXPECT_NEAR(rows[played.first_row - 15][0], 0.2, 1e-12) << "stands for half a second";
  ASSERT_EQ(rows.size() - played.first_row, 61u);
  for (size_t i = 0; i <= 60; ++i) {
    const double t = static_cast<double>(i) * kPeriod;
    // A cubic between poses 20 ms apart: h^4 / 384 of the fourth derivative would be 3e-7; a
    // monotone one loses two orders at the turn.
    EXPECT_NEAR(rows[played.first_row + i][0], 0.2 + 0.15 * (1 - std::cos(M_PI * t)), 3e-4);
    for (int axis = 1; axis < piper::kAxes; ++axis)
      EXPECT_EQ(rows[played.first_row + i][axis], from[axis]) << "an axis that it does not give";
  }
}

TEST(MotionTest, PlayedSlowlyNoJointIsFasterThanThatShareOfTheTopSpeed) {
  const Motion motion = Swing(0.3);  // top speed 0.3 pi / 2
  const PlayedMotion played = PlayMotion(motion, 0.25, {}, PathLimits{}, kPeriod);
  const std::vector<ArmVector>& rows = played.path.rows;
  double fastest = 0, highest = 0;
  for (size_t i = played.first_row + 1; i < rows.size(); ++i) {
    fastest = std::max(fastest, std::abs(rows[i][0] - rows[i - 1][0]) / kPeriod);
    highest = std::max(highest, rows[i][0]);
  }
  EXPECT_LE(fastest, 0.25 * 0.3 * M_PI / 2 * 1.001);
  EXPECT_GE(fastest, 0.25 * 0.3 * M_PI / 2 * 0.95);
  EXPECT_NEAR(highest, 0.3, 2e-3) << "the same way";
  EXPECT_NEAR(rows.back()[0], 0, 1e-12);
  EXPECT_LE(rows.size() - played.first_row, 4 * 61u) << "at most as much slower";
}

TEST(MotionTest, RefusesASpeedThatTheLimitsDoNotAllowAndSaysWhichTheyDo) {
  const Motion motion = Swing(0.6);  // 0.94 rad/s
  const auto check = [&](double speed, double limit = 0.5) {
    return CheckSpeed(PlayMotion(motion, speed, {}, PathLimits{}, kPeriod), speed, limit, kPeriod);
  };
  const absl::Status refused = check(1);
  EXPECT_EQ(refused.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("J1 would reach 0.9"));
  EXPECT_THAT(std::string(refused.message()), HasSubstr("type play 0.52"));
  EXPECT_TRUE(check(0.52).ok()) << "what it says must be true";
  EXPECT_FALSE(check(1, 0.93).ok());
  EXPECT_TRUE(check(1, 0.95).ok());
}

TEST(MotionTest, RefusesWhatNoArmCouldPlay) {
  const ArmLimits limits = Limits();
  EXPECT_TRUE(CheckMotion(Swing(0.3), limits).ok());
  const auto refused = [&](const Motion& motion, const char* why) {
    const absl::Status status = CheckMotion(motion, limits);
    EXPECT_EQ(status.code(), absl::StatusCode::kInvalidArgument);
    EXPECT_THAT(std::string(status.message()), HasSubstr(why));
  };
  Motion motion = Swing(0.3);
  motion.t[3] = motion.t[2];
  refused(motion, "time 3 is 0.04 s after 0.04 s");
  motion = Swing(0.3);
  motion.t[0] = -1;
  refused(motion, "time 0 is -1 s");
  motion = Swing(0.3);
  motion.t.back() = std::numeric_limits<double>::infinity();
  refused(motion, "times begin at 0");
  motion = Swing(0.3);
  motion.poses[7][0] = std::nan("");
  refused(motion, "at t = 0.140 s J1 is nan");
  refused(Swing(3.0), "J1 is");  // beyond 2.6 rad
  motion = Swing(0.3);
  motion.moves.fill(false);
  refused(motion, "moves no axis");
  motion = Swing(0.3);
  motion.poses.pop_back();
  refused(motion, "holds 100 poses at 101 times");
  refused(Motion{"empty"}, "holds 0 poses");
  motion = Swing(0.3);
  motion.poses[0][3] = std::nan("");  // of an axis that it does not give
  EXPECT_TRUE(CheckMotion(motion, limits).ok());
  motion = Swing(0.3);
  motion.moves.fill(true);
  motion.poses[7][piper::kJoints] =
      limits.upper[piper::kJoints] + 0.03;  // a hand at the gripper's end
  EXPECT_TRUE(CheckMotion(motion, limits).ok()) << CheckMotion(motion, limits);
  motion.poses[7][piper::kJoints] = limits.upper[piper::kJoints] + 0.06;
  refused(motion, "gripper is");
}

TEST(ExcitationTest, MovesEveryJointWithinLimitsAndWorkspaceAndReturns) {
  WorkspaceOptions workspace;
  const piper::PiperModel model(piper::Zero::kSince_1_6_3, workspace);
  ExcitationOptions options;
  options.centre = {0, 1.0, -0.9, 0, 0.4, 0, 0.03};
  const auto motion = DesignExcitation(options, Limits(), &model);
  ASSERT_TRUE(motion.ok()) << motion.status();
  ASSERT_TRUE(CheckMotion(*motion, Limits()).ok());
  EXPECT_GT(motion->duration_s(), 60);
  EXPECT_LT(motion->duration_s(), 180);
  EXPECT_FALSE(motion->moves[piper::kJoints]);
  const PlayedMotion played = PlayMotion(*motion, 1, options.centre, PathLimits{}, kPeriod);
  EXPECT_TRUE(CheckPath(model, played.path).ok());
  ArmVector travel{}, fastest{}, alone{};
  for (size_t i = 1; i < motion->t.size(); ++i) {
    const ArmModel::Clearance clearance = model.ClearanceAt(motion->poses[i]);
    for (const double distance : clearance) ASSERT_GE(distance, options.clearance - 1e-9);
    int moving = 0, last = 0;
    for (int j = 0; j < piper::kJoints; ++j) {
      const double step = std::abs(motion->poses[i][j] - motion->poses[i - 1][j]);
      travel[j] += step;
      fastest[j] = std::max(fastest[j], step / (motion->t[i] - motion->t[i - 1]));
      moving += step > 1e-9;
      if (step > 1e-9) last = j;
    }
    if (moving == 1) alone[last] += motion->t[i] - motion->t[i - 1];
  }
  for (int j = 0; j < piper::kJoints; ++j) {
    EXPECT_GT(travel[j], 2) << j;  // [rad]
    EXPECT_LE(fastest[j], options.joint_velocity * 1.01) << j;
    EXPECT_GT(fastest[j], 0.5 * options.joint_velocity) << j;
    EXPECT_GT(alone[j], 5) << j;  // [s]
    EXPECT_NEAR(motion->poses.back()[j], options.centre[j], 1e-3) << j;
  }
}

TEST(ExcitationTest, SaysWhatLeavesNoRoom) {
  WorkspaceOptions workspace;
  workspace.table_z = 0.6;  // above the arm
  const piper::PiperModel model(piper::Zero::kSince_1_6_3, workspace);
  ExcitationOptions options;
  options.centre = {0, 1.0, -0.9, 0, 0.4, 0, 0.03};
  auto motion = DesignExcitation(options, Limits(), &model);
  EXPECT_EQ(motion.status().code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(motion.status().message()), HasSubstr("(the table); move home"));
  options.centre[3] = 9;
  motion = DesignExcitation(options, Limits(), nullptr);
  EXPECT_THAT(std::string(motion.status().message()), HasSubstr("has J4 at 9.000 rad"));
}

}  // namespace
}  // namespace robostress
