// What the emulated arm answers and how it moves, as other programs than our client ask it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <vector>

#include "robot_client/emulator/arm_settings.h"
#include "robot_client/emulator/tool_path.h"
#include "tests/robot_client/piper/emulated_arm.h"

namespace robostress::piper {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

// An arm and a third node that commands it past the client.
class Firmware : public ::testing::Test {
 protected:
  void Say(const CanFrame& frame) { ASSERT_TRUE(world_.third->Send(frame).ok()); }
  // Frames with these identifiers, over the seconds to come.
  std::vector<CanFrame> Hear(double seconds, uint16_t first, uint16_t last) {
    StampedFrame frame;
    while (world_.third->Receive(frame)) {
    }
    return HearOn(seconds, first, last);
  }
  std::vector<CanFrame> HearOn(double seconds, uint16_t first, uint16_t last) {
    std::vector<CanFrame> heard;
    StampedFrame frame;
    for (int i = 0; i < static_cast<int>(std::lround(1000 * seconds)); ++i) {
      world_.time.SleepUntil(world_.time.now_ns() + 1'000'000);
      while (world_.third->Receive(frame)) {
        if (frame.frame.id >= first && frame.frame.id <= last) heard.push_back(frame.frame);
      }
    }
    return heard;
  }
  // What answers a frame between 0x470 and 0x4AF.
  std::vector<CanFrame> Ask(const CanFrame& question) {
    StampedFrame frame;
    while (world_.third->Receive(frame)) {
    }
    Say(question);
    return HearOn(0.02, 0x470, 0x4AF);
  }
  void Enable() {
    for (int i = 0; i < 2; ++i) Say(Encode(MotorPower{kAllMotors, true}));
    world_.Run(0.05);
    for (int j = 0; j < kJoints; ++j) ASSERT_TRUE(world_.emulator->firmware().enabled(j));
  }
  void SayPose(const Eigen::Vector3d& p, const Eigen::Vector3d& rpy) {
    CanFrame frames[3] = {EncodeEndPose(0, p.x(), p.y()), EncodeEndPose(1, p.z(), rpy[0]),
                          EncodeEndPose(2, rpy[1], rpy[2])};
    for (CanFrame& frame : frames) {
      frame.id = static_cast<uint16_t>(frame.id - kEndPose + 0x152);
      Say(frame);
    }
  }
  void GoTo(MoveMode mode, const Eigen::Vector3d& p, const Eigen::Vector3d& rpy, int percent) {
    Say(Encode(ModeControl{ControlMode::kCan, mode, percent}));
    SayPose(p, rpy);
  }
  // Tool positions, one per millisecond.
  std::vector<Eigen::Vector3d> Watch(double seconds) {
    std::vector<Eigen::Vector3d> path;
    for (int i = 0; i < static_cast<int>(1000 * seconds); ++i) {
      world_.time.SleepUntil(world_.time.now_ns() + 1'000'000);
      path.push_back(Tool().translation());
    }
    return path;
  }
  Eigen::Isometry3d Tool() {
    return ToolPose(world_.emulator->plant().link_angles(), Zero::kSince_1_6_3);
  }
  StatusCode Code() { return world_.emulator->firmware().status().code; }

  EmulatedArm world_;
};

CanFrame Frame(uint16_t id, std::array<uint8_t, 8> data) { return {id, 8, data}; }

TEST_F(Firmware, AnswersQueriesAsTheSdkSendsThem) {
  // piper_sdk's ArmParamEnquiryAndConfig fills byte 4 with 3, "no load given".
  EXPECT_THAT(Ask(Frame(0x477, {1, 0, 0, 0, 3})),
              ElementsAre(Frame(0x478, {0x01, 0xF4, 0x05, 0xDC, 0x03, 0x20, 0x07, 0xD0})));
  EXPECT_THAT(Ask(Frame(0x477, {2, 0, 0, 0, 3})), ElementsAre(Frame(0x47B, {})));
  EXPECT_THAT(Ask(Frame(0x477, {4, 0, 0, 0, 3})), ElementsAre(Frame(0x47E, {100, 70, 1})));
  // A query and a setting in one frame: both count.
  EXPECT_THAT(Ask(Frame(0x477, {1, 2, 0, 0, 2})),
              ElementsAre(Frame(0x476, {0x77}),
                          Frame(0x478, {0x01, 0xF4, 0x05, 0xDC, 0x03, 0x20, 0x07, 0xD0})));
  // A load is written; nothing is asked.
  EXPECT_THAT(Ask(Frame(0x477, {0, 0, 0, 0xAE, 2})), ElementsAre(Frame(0x476, {0x77})));
}

TEST_F(Firmware, ReadsBackWhatWasWritten) {
  const CanFrame ask_acceleration = Frame(0x472, {3, 2});
  EXPECT_THAT(Ask(ask_acceleration), ElementsAre(Frame(0x47C, {3, 0x01, 0xF4})));
  EXPECT_THAT(Ask(Frame(0x475, {3, 0, 0xAE, 0x01, 0x2C})), ElementsAre(Frame(0x476, {0x75})));
  EXPECT_THAT(Ask(ask_acceleration), ElementsAre(Frame(0x47C, {3, 0x01, 0x2C})));
  Ask(Frame(0x475, {3, 0, 0xAE, 0x7F, 0xFF}));  // "leave it"
  Ask(Frame(0x475, {3, 0, 0, 0x00, 0x01}));     // not marked as meant
  EXPECT_THAT(Ask(ask_acceleration), ElementsAre(Frame(0x47C, {3, 0x01, 0x2C})));
  Ask(Frame(0x475, {7, 0, 0xAE, 0x00, 0xC8}));  // every motor
  EXPECT_THAT(Ask(Frame(0x472, {6, 2})), ElementsAre(Frame(0x47C, {6, 0x00, 0xC8})));

  Ask(Frame(0x474, {2, 0x7F, 0xFF, 0x7F, 0xFF, 0x00, 0x96}));  // J2: speed only
  EXPECT_THAT(Ask(Frame(0x472, {2, 1})),
              ElementsAre(Frame(0x473, {2, 0x07, 0x07, 0x00, 0x00, 0x00, 0x96})));
  Ask(Frame(0x477, {0, 2}));  // the joints' limits as delivered
  EXPECT_THAT(Ask(Frame(0x472, {2, 1})),
              ElementsAre(Frame(0x473, {2, 0x07, 0x07, 0x00, 0x00, 0x01, 0x2C})));
  EXPECT_THAT(Ask(ask_acceleration), ElementsAre(Frame(0x47C, {3, 0x01, 0xF4})));

  Ask(Frame(0x47A, {1, 2, 3, 4, 5, 0xFF}));
  EXPECT_THAT(Ask(Frame(0x477, {2})), ElementsAre(Frame(0x47B, {1, 2, 3, 4, 5, 0})));
  Ask(Frame(0x479, {0x00, 0x64, 0x7F, 0xFF, 0x7F, 0xFF, 0x7F, 0xFF}));
  EXPECT_THAT(Ask(Frame(0x477, {1})),
              ElementsAre(Frame(0x478, {0x00, 0x64, 0x05, 0xDC, 0x03, 0x20, 0x07, 0xD0})));
  Ask(Frame(0x47D, {120, 100, 5}));
  EXPECT_THAT(Ask(Frame(0x477, {4})), ElementsAre(Frame(0x47E, {120, 100, 5})));
  EXPECT_THAT(Ask(Encode(MotorPower{7, true})), ElementsAre(Frame(0x476, {0x71})));
}

TEST_F(Firmware, AnAccelerationThatWasWrittenIsKept) {
  Enable();
  Ask(Frame(0x475, {1, 0, 0xAE, 0x00, 0x64}));  // 1 rad/s^2
  Say(Encode(ModeControl{ControlMode::kCan, MoveMode::kJ, 100}));
  Say(EncodeJointTargets({0, 1, 0}));
  world_.Run(1.06);  // the command lag and one second: half a radian with 1 rad/s^2, past it with 5
  EXPECT_NEAR(world_.emulator->plant().link_angles()[0], 0.5, 0.1);
}

TEST_F(Firmware, SetsAZeroWhereAMotorWithoutPowerStands) {
  const JointVector start = {0.3, 0.5, -0.4, 0.1, 0.2, -0.3};
  EmulatorOptions options;
  options.start = start;
  EmulatedArm world(options);
  world.arm->Connect().IgnoreError();
  EXPECT_NEAR(world.arm->Latest().position[1], 0.5, 3e-3);
  ASSERT_TRUE(world.third->Send(Frame(0x475, {2, 0xAE})).ok());
  world.Run(0.05);
  EXPECT_NEAR(world.arm->Latest().position[1], 0, 3e-3);
  EXPECT_NEAR(world.arm->Latest().position[2], -0.4, 3e-3);
  EXPECT_NEAR(world.emulator->plant().link_angles()[1], 0.5, 3e-3);  // nothing moved
  // The zero is the one that targets are read in.
  for (int i = 0; i < 2; ++i) ASSERT_TRUE(world.third->Send(Encode(MotorPower{7, true})).ok());
  world.Run(0.05);
  ASSERT_TRUE(world.third->Send(Encode(ModeControl{ControlMode::kCan, MoveMode::kJ, 100})).ok());
  ASSERT_TRUE(world.third->Send(EncodeJointTargets({0, 0.3, 0.2})).ok());
  world.Run(2);
  EXPECT_NEAR(world.emulator->plant().link_angles()[1], 0.7, 0.01);
}

TEST_F(Firmware, SaysWhetherAZeroWasSet) {
  EXPECT_THAT(Ask(Frame(0x475, {4, 0xAE})), ElementsAre(Frame(0x476, {0x75, 1})));
  Enable();
  EXPECT_THAT(Ask(Frame(0x475, {4, 0xAE})), ElementsAre(Frame(0x476, {0x75, 0})));
}

TEST_F(Firmware, SetsTheGrippersZeroAndReportsNoOpeningWithoutARange) {
  Enable();
  GripperTarget open;
  open.opening = 0.03;
  open.effort = 1;
  Say(Encode(open));
  world_.Run(1);
  const auto opening = [&] {
    return DecodeGripperStatus(Hear(0.01, kGripper, kGripper).at(0))->opening;
  };
  EXPECT_NEAR(opening(), 0.03, 1e-3);
  GripperTarget zero;
  zero.enable = false;
  zero.set_zero = true;
  Say(Encode(zero));
  world_.Run(0.1);
  EXPECT_NEAR(opening(), 0, 2e-3);
  Say(Frame(0x47D, {100, 0, 1}));
  Say(Encode(open));
  world_.Run(1);
  EXPECT_EQ(opening(), 0);
}

TEST_F(Firmware, MoveLLeadsTheToolAlongAStraightLine) {
  Enable();
  const Eigen::Vector3d down(M_PI, 0, M_PI);
  const std::vector<Eigen::Vector3d> corners = {
      {0.15, -0.05, 0.15}, {0.15, 0.05, 0.15}, {0.25, 0.05, 0.15}, {0.25, -0.05, 0.15}};
  GoTo(MoveMode::kP, corners[0], down, 100);
  world_.Run(4);
  ASSERT_LT((Tool().translation() - corners[0]).norm(), 1e-3);
  double worst = 0;
  for (size_t i = 0; i < corners.size(); ++i) {
    const Eigen::Vector3d from = Tool().translation();
    const Eigen::Vector3d& to = corners[(i + 1) % corners.size()];
    GoTo(MoveMode::kL, to, down, 100);
    for (const Eigen::Vector3d& p : Watch(2)) {
      const Eigen::Vector3d way = (to - from).normalized();
      worst = std::max(worst, (p - from - way * way.dot(p - from)).norm());
    }
    EXPECT_LT((Tool().translation() - to).norm(), 1e-3);
    EXPECT_EQ(Code(), StatusCode::kNormal);
    EXPECT_FALSE(world_.emulator->firmware().status().moving);
  }
  EXPECT_LT(worst, 1e-3);
  RecordProperty("worst_um", static_cast<int>(1e6 * worst));
  // The same way joint by joint is no line.
  GoTo(MoveMode::kP, corners[2], down, 100);
  const Eigen::Vector3d from = Tool().translation(), way = (corners[2] - from).normalized();
  double bent = 0;
  for (const Eigen::Vector3d& p : Watch(2))
    bent = std::max(bent, (p - from - way * way.dot(p - from)).norm());
  EXPECT_GT(bent, 3e-3);
}

TEST_F(Firmware, MoveCLeadsTheToolAlongTheArcThroughThreePoints) {
  Enable();
  const Eigen::Vector3d down(M_PI, 0, M_PI), centre(0.25, 0, 0.15);
  const auto point = [&](double angle) {
    return Eigen::Vector3d(centre + 0.06 * Eigen::Vector3d(std::cos(angle), std::sin(angle), 0));
  };
  Say(Encode(ModeControl{ControlMode::kCan, MoveMode::kC, 60}));
  const double angles[3] = {-M_PI / 2, 0, M_PI / 2};
  for (uint8_t i = 0; i < 3; ++i) {
    SayPose(point(angles[i]), down);
    Say(Frame(0x158, {static_cast<uint8_t>(i + 1)}));
  }
  bool arrived = false;
  double worst = 0, farthest = 0;
  for (const Eigen::Vector3d& p : Watch(8)) {
    arrived = arrived || (p - point(angles[0])).norm() < 1e-3;
    if (!arrived) continue;
    worst = std::max(worst, std::abs((p - centre).norm() - 0.06));
    worst = std::max(worst, std::abs(p.z() - centre.z()));
    farthest = std::max(farthest, p.x());
  }
  EXPECT_TRUE(arrived);
  EXPECT_LT(worst, 1.5e-3);
  EXPECT_NEAR(farthest, point(angles[1]).x(), 1e-3);  // by way of the middle, not the other side
  EXPECT_LT((Tool().translation() - point(angles[2])).norm(), 1e-3);
  EXPECT_EQ(Code(), StatusCode::kNormal);
}

TEST_F(Firmware, NamesALineThatItCannotFollowAndAnArcThatIsNone) {
  Enable();
  const Eigen::Vector3d down(M_PI, 0, M_PI);
  GoTo(MoveMode::kP, {0.25, -0.05, 0.15}, down, 100);
  world_.Run(4);
  // Both ends can be reached; the line between them goes through the arm's own base.
  GoTo(MoveMode::kL, {-0.25, 0.05, 0.15}, down, 100);
  world_.Run(4);
  EXPECT_EQ(Code(), StatusCode::kNoSolution);
  GoTo(MoveMode::kP, {0.25, -0.05, 0.15}, down, 100);
  world_.Run(4);
  EXPECT_EQ(Code(), StatusCode::kNormal);
  Say(Encode(ModeControl{ControlMode::kCan, MoveMode::kC, 60}));
  for (uint8_t i = 0; i < 3; ++i) {
    SayPose({0.2 + 0.02 * i, 0, 0.15}, down);
    Say(Frame(0x158, {static_cast<uint8_t>(i + 1)}));
  }
  world_.Run(4);
  EXPECT_EQ(Code(), StatusCode::kNoSolution);
}

TEST_F(Firmware, ALeaderIsSilentAndCommands) {
  EXPECT_THAT(Ask(Frame(0x470, {0xFA, 0, 0, 0})), ElementsAre(Frame(0x476, {0x70})));
  EXPECT_THAT(Hear(0.5, 0x2A1, 0x2A8), ElementsAre());
  std::map<int, int> counts;
  for (const CanFrame& frame : Hear(1, 0x150, 0x15F)) ++counts[frame.id];
  EXPECT_EQ(counts, (std::map<int, int>{
                        {0x151, 200}, {0x155, 200}, {0x156, 200}, {0x157, 200}, {0x159, 200}}));
  // Our client refuses it; a command to it changes nothing.
  const absl::Status status = world_.arm->Connect();
  EXPECT_THAT(std::string(status.message()), HasSubstr("another sender commands this arm"));
  Ask(Frame(0x470, {0xFC, 0, 0, 0}));
  EXPECT_EQ(Hear(0.5, 0x2A1, 0x2A8).size(), 800u);
  EXPECT_THAT(Hear(0.5, 0x150, 0x15F), ElementsAre());
  world_.Run(0.1);  // the client reads what came while it was a leader
  EXPECT_TRUE(world_.arm->Connect().ok());
}

TEST_F(Firmware, OffsetsMoveFeedbackAndCommands) {
  Ask(Frame(0x470, {0xFC, 0x10, 0x20, 0}));
  EXPECT_THAT(Hear(0.2, 0x2A1, 0x2A8), ElementsAre());
  EXPECT_EQ(Hear(0.2, 0x2B1, 0x2B8).size(), 320u);
  Enable();
  const auto command = [&](uint16_t offset, double target) {
    for (CanFrame frame : {Encode(ModeControl{ControlMode::kCan, MoveMode::kJ, 100}),
                           EncodeJointTargets({0, target, 0})}) {
      frame.id = static_cast<uint16_t>(frame.id + offset);
      Say(frame);
    }
    world_.Run(1);
  };
  command(0, 0.3);
  EXPECT_NEAR(world_.emulator->plant().link_angles()[0], 0, 0.01);
  command(0x20, 0.3);
  EXPECT_NEAR(world_.emulator->plant().link_angles()[0], 0.3, 0.01);
}

TEST(ToolPath, KeepsItsLimitsAndItsCircle) {
  ToolPath path;
  const auto at = [](double x, double y, double z) {
    return ToolTarget{{x, y, z}, Eigen::Quaterniond::Identity()};
  };
  // A circle of radius 1 about (1, 2, 3), three quarters of it.
  ASSERT_TRUE(path.StartArc(at(2, 2, 3), at(0, 2, 3), at(1, 1, 3)));
  ToolLimits limits;
  limits.velocity = 0.5;
  limits.acceleration = 1;
  Eigen::Vector3d before(2, 2, 3);
  double fastest = 0;
  int steps = 0;
  while (!path.at_end() && steps < 100'000) {
    path.Step(limits, 100, 0.001);
    const Eigen::Vector3d p = path.target().p;
    fastest = std::max(fastest, (p - before).norm() / 0.001);
    EXPECT_NEAR((p - Eigen::Vector3d(1, 2, 3)).norm(), 1, 1e-12);
    before = p;
    ++steps;
  }
  EXPECT_NEAR(fastest, 0.5, 1e-3);
  EXPECT_NEAR((before - Eigen::Vector3d(1, 1, 3)).norm(), 0, 1e-6);
  // Three quarters of 2 pi at 0.5 m/s, and the ramps: way / v + v / a.
  EXPECT_NEAR(steps * 0.001, 1.5 * M_PI / 0.5 + 0.5, 0.01);
  EXPECT_FALSE(path.StartArc(at(0, 0, 0), at(1, 0, 0), at(2, 0, 0)));
  EXPECT_FALSE(path.StartArc(at(0, 0, 0), at(0, 0, 0), at(2, 0, 0)));
}

}  // namespace
}  // namespace robostress::piper
