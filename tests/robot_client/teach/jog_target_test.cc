#include "robot_client/teach/jog_target.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <new>

#include "robot_client/piper/kinematics.h"

namespace {
bool count_allocations = false;
int allocations = 0;
}  // namespace

void* operator new(size_t size) {
  if (count_allocations) ++allocations;
  if (void* memory = std::malloc(size)) return memory;
  throw std::bad_alloc();
}
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, size_t) noexcept { std::free(memory); }

namespace robostress {
namespace {

constexpr auto kZero = piper::Zero::kSince_1_6_3;
constexpr double kPeriod_s = 1.0 / 30;

piper::JointVector JointsOf(const ArmVector& position) {
  piper::JointVector q;
  std::copy_n(position.begin(), piper::kJoints, q.begin());
  return q;
}

Eigen::Isometry3d ToolOf(const ArmVector& position) {
  return piper::ToolPose(JointsOf(position), kZero);
}

ArmLimits Limits() {
  ArmLimits limits;
  for (int j = 0; j < piper::kJoints; ++j) {
    limits.lower[j] = piper::kJointRanges[j].lower;
    limits.upper[j] = piper::kJointRanges[j].upper;
  }
  limits.upper[piper::kJoints] = 0.07;
  return limits;
}

// A person in time; the command follows the target at once.
struct Bench {
  SnapshotCell<JogInput> cell;
  const JogOptions options;
  JogTarget target{&cell,
                   [](const ArmVector& q) { return piper::ToolJacobian(JointsOf(q), kZero); },
                   Limits(), options};
  ArmVector command;
  int64_t now_ns = 1'000'000'000;

  explicit Bench(const ArmVector& start = {0.2, 1.2, -1.0, 0.1, 0.5, 0.2, 0.03},
                 double tool_velocity = 0.1)
      : options{.tool_velocity = tool_velocity, .turn_velocity = 5 * tool_velocity},
        command(start) {
    target.Begin(command);
  }
  // `held`: how long the key is confirmed.
  void Hold(JogInput input, double seconds, double held = 1e9) {
    const int64_t start = now_ns;
    for (int i = 0; i < std::lround(seconds / kPeriod_s); ++i) {
      now_ns += static_cast<int64_t>(kPeriod_s * 1e9);
      if (static_cast<double>(now_ns - start) * 1e-9 <= held) {
        input.stamp_ns = now_ns;
        cell.Store(input);
      }
      const ArmVector before = command;
      const LiveRow row = target.Next(now_ns, command);
      command = row.target;
      EXPECT_EQ(row.wanted, row.target);
      EXPECT_FALSE(row.joining);
      for (int j = 0; j < piper::kJoints; ++j)
        fastest = std::max(fastest, std::abs(command[j] - before[j]) / kPeriod_s);
    }
  }
  double fastest = 0;  // joint [rad/s]
};

JogInput Axis(int axis, double share) {
  JogInput input;
  input.tool[axis] = share;
  return input;
}

TEST(JogTargetTest, TheToolGoesStraightAtItsSpeedWithoutTurning) {
  for (int axis = 0; axis < 3; ++axis) {
    Bench bench({0.2, 1.2, -1.0, 0.1, 0.5, 0.2, 0.03}, 0.04);
    const Eigen::Isometry3d before = ToolOf(bench.command);
    bench.Hold(Axis(axis, -1), 1);
    const Eigen::Isometry3d after = ToolOf(bench.command);
    Eigen::Vector3d expected = Eigen::Vector3d::Zero();
    expected[axis] = -0.04;
    EXPECT_LT(bench.fastest, bench.options.fastest_joint) << "nothing is slowed down";
    // 30 Euler steps of 1.3 mm, each off by its square over the arm's size: 6 um.
    EXPECT_LT((after.translation() - before.translation() - expected).norm(), 5e-4) << axis;
    EXPECT_LT(Eigen::AngleAxisd(after.linear() * before.linear().transpose()).angle(), 5e-3);
  }
}

TEST(JogTargetTest, TheToolTurnsAboutItsOwnPlace) {
  Bench bench({0.2, 1.2, -1.0, 0.1, 0.5, 0.2, 0.03}, 0.03);
  const Eigen::Isometry3d before = ToolOf(bench.command);
  bench.Hold(Axis(5, 1), 1);
  const Eigen::Isometry3d after = ToolOf(bench.command);
  EXPECT_LT((after.translation() - before.translation()).norm(), 2e-3);
  const Eigen::AngleAxisd turn(after.linear() * before.linear().transpose());
  EXPECT_NEAR(turn.angle(), 0.15, 2e-3);
  EXPECT_GT(turn.axis().z(), 0.99);
}

// Sideways at 0.1 m/s would take J6 to 1.1 rad/s here.
TEST(JogTargetTest, AMotionThatIsTooFastForAJointIsSlowedDownAndStaysStraight) {
  Bench bench;
  const Eigen::Vector3d before = ToolOf(bench.command).translation();
  bench.Hold(Axis(1, -1), 0.5);
  const Eigen::Vector3d way = ToolOf(bench.command).translation() - before;
  EXPECT_NEAR(bench.fastest, bench.options.fastest_joint, 1e-9);
  EXPECT_LT(way.y(), -0.02);
  EXPECT_GT(way.y(), -0.035);
  EXPECT_LT(std::hypot(way.x(), way.z()), 1e-3);
}

TEST(JogTargetTest, AJointAloneMovesAtItsSpeedAndTheGripperAtIts) {
  Bench bench;
  JogInput input = Axis(0, 1);
  input.by_joint = true;
  input.joint = 3;
  bench.Hold(input, 1);
  EXPECT_NEAR(bench.command[3], 0.1 + 0.2, 1e-9);
  EXPECT_NEAR(bench.command[1], 1.2, 1e-12);
  JogInput open;
  open.gripper = 1;
  bench.Hold(open, 0.4);
  EXPECT_NEAR(bench.command[piper::kJoints], 0.03 + 0.02, 1e-9);
  bench.Hold(open, 2);
  EXPECT_NEAR(bench.command[piper::kJoints], 0.07, 1e-12) << "the gripper's own end";
}

TEST(JogTargetTest, AKeyThatIsNotRepeatedStopsWithinAQuarterOfASecond) {
  Bench bench;
  bench.Hold(Axis(0, 1), 0.5, 0.1);
  const ArmVector stopped = bench.command;
  const double way = (ToolOf(stopped).translation() -
                      ToolOf(ArmVector{0.2, 1.2, -1.0, 0.1, 0.5, 0.2, 0.03}).translation())
                         .norm();
  EXPECT_NEAR(way, 0.1 * (0.1 + 0.25), 0.1 * 0.04);
  bench.Hold(Axis(0, 1), 1, -1);
  EXPECT_EQ(bench.command, stopped);
}

// The wrist is singular where J5 is 0, the arm where it is stretched, the shoulder where the wrist
// is above J1: each is driven through or into from both sides.
TEST(JogTargetTest, NoJointIsFastInASingularityAndNoneLeavesItsLimits) {
  const ArmVector starts[] = {{0, 1.2, -1.0, 0.3, 0.05, 0, 0.03},
                              {0, 1.6, -0.15, 0, 0.1, 0, 0.03},
                              {0, 0.25, -2.4, 0, 0.3, 0, 0.03},
                              {1.0, 0.6, -1.9, 0.2, 1.1, 0.5, 0.03}};
  for (const ArmVector& start : starts) {
    for (int axis = 0; axis < 6; ++axis) {
      for (const double share : {-1.0, 1.0}) {
        Bench bench(start);
        bench.Hold(Axis(axis, share), 6);
        EXPECT_LE(bench.fastest, bench.options.fastest_joint + 1e-9) << axis << " " << share;
        for (int j = 0; j < piper::kJoints; ++j) {
          EXPECT_GE(bench.command[j], Limits().lower[j] + 0.02 - 1e-9) << j;
          EXPECT_LE(bench.command[j], Limits().upper[j] - 0.02 + 1e-9) << j;
        }
      }
    }
  }
}

TEST(JogTargetTest, TheArmComesOutOfASingularityAgain) {
  Bench bench({0, 1.2, -1.0, 0, 0.0, 0, 0.03});
  const Eigen::Isometry3d before = ToolOf(bench.command);
  bench.Hold(Axis(2, -1), 1);
  EXPECT_NEAR(ToolOf(bench.command).translation().z() - before.translation().z(), -0.1, 0.01);
}

TEST(JogTargetTest, AllocatesNothing) {
  Bench bench;
  count_allocations = true;
  bench.Hold(Axis(2, 1), 2);
  count_allocations = false;
  EXPECT_EQ(allocations, 0);
}

TEST(JogTargetTest, WaitsForACommandThatIsKeptBackAndIsSilentWhenTheDeviceIsGone) {
  Bench bench;
  JogInput input = Axis(0, 1);
  input.by_joint = true;
  input.joint = 0;
  const ArmVector kept = bench.command;  // the workspace stops it here
  ArmVector target = kept;
  for (int i = 0; i < 60; ++i) {
    bench.now_ns += static_cast<int64_t>(kPeriod_s * 1e9);
    input.stamp_ns = bench.now_ns;
    bench.cell.Store(input);
    target = bench.target.Next(bench.now_ns, kept).target;
  }
  EXPECT_NEAR(target[0] - kept[0], 0.1, 1e-9) << "not two seconds of motion ahead";
  EXPECT_FALSE(bench.target.Silent(bench.now_ns));
  input.gone = true;
  bench.cell.Store(input);
  EXPECT_TRUE(bench.target.Silent(bench.now_ns));
  EXPECT_EQ(bench.target.Next(bench.now_ns, kept).target[0], target[0]);
}

}  // namespace
}  // namespace robostress
