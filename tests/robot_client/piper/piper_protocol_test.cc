#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <vector>

#include "common/random.h"
#include "robot_client/piper/command_guard.h"
#include "robot_client/piper/firmware.h"
#include "robot_client/piper/joint_assembler.h"
#include "robot_client/piper/kinematics.h"
#include "robot_client/piper/limit_check.h"
#include "robot_client/piper/protocol.h"
#include "robot_client/snapshot_cell.h"

namespace robostress::piper {
namespace {

using ::testing::HasSubstr;

constexpr double kMilliDegree = M_PI / 180'000;

// Frames as C_PiperInterface_V2 of piper_sdk 0.6.1 sends them; its calls stand on the right.
TEST(Protocol, WritesWhatTheVendorsSdkWrites) {
  EXPECT_EQ(EncodeStop(Stop::kQuick), (CanFrame{0x150, 8, {1}}));  // EmergencyStop(1)
  EXPECT_EQ(EncodeStop(Stop::kReset), (CanFrame{0x150, 8, {2}}));  // EmergencyStop(2)
  EXPECT_EQ(Encode(ModeControl{ControlMode::kCan, MoveMode::kJ, 73, Follow::kPlanned}),
            (CanFrame{0x151, 8, {1, 1, 0x49}}));  // MotionCtrl_2(1, 1, 73, 0)
  EXPECT_EQ(Encode(ModeControl{ControlMode::kCan, MoveMode::kJ, 100, Follow::kDirect}),
            (CanFrame{0x151, 8, {1, 1, 0x64, 0xAD}}));  // MotionCtrl_2(1, 1, 100, 0xAD)
  // JointCtrl(12345, -6789, -90000, 1, -1, 120000)
  EXPECT_EQ(EncodeJointTargets({0, 12345 * kMilliDegree, -6789 * kMilliDegree}),
            (CanFrame{0x155, 8, {0, 0, 0x30, 0x39, 0xFF, 0xFF, 0xE5, 0x7B}}));
  EXPECT_EQ(EncodeJointTargets({1, -90000 * kMilliDegree, 1 * kMilliDegree}),
            (CanFrame{0x156, 8, {0xFF, 0xFE, 0xA0, 0x70, 0, 0, 0, 1}}));
  EXPECT_EQ(EncodeJointTargets({2, -1 * kMilliDegree, 120000 * kMilliDegree}),
            (CanFrame{0x157, 8, {0xFF, 0xFF, 0xFF, 0xFF, 0, 1, 0xD4, 0xC0}}));
  EXPECT_EQ(Encode(GripperTarget{0.035, 1.5, true}),
            (CanFrame{0x159, 8, {0, 0, 0x88, 0xB8, 0x05, 0xDC, 1, 0}}));  // (35000, 1500, 1, 0)
  EXPECT_EQ(Encode(GripperTarget{0, 5, true, true}),
            (CanFrame{0x159, 8, {0, 0, 0, 0, 0x13, 0x88, 3, 0}}));  // (0, 5000, 3, 0)
  EXPECT_EQ(Encode(GripperTarget{0.07, 0, false, false, true}),
            (CanFrame{0x159, 8, {0, 1, 0x11, 0x70, 0, 0, 0, 0xAE}}));     // (70000, 0, 0, 0xAE)
  EXPECT_EQ(Encode(MotorPower{7, true}), (CanFrame{0x471, 8, {7, 2}}));   // EnableArm(7)
  EXPECT_EQ(Encode(MotorPower{3, true}), (CanFrame{0x471, 8, {3, 2}}));   // EnableArm(3)
  EXPECT_EQ(Encode(MotorPower{7, false}), (CanFrame{0x471, 8, {7, 1}}));  // DisableArm(7)
  EXPECT_EQ(Encode(LimitQuery{4, false}), (CanFrame{0x472, 8, {4, 1}}));
  EXPECT_EQ(Encode(LimitQuery{6, true}), (CanFrame{0x472, 8, {6, 2}}));
  EXPECT_EQ(EncodeFirmwareQuery(), (CanFrame{0x4AF, 8, {1}}));
}

TEST(Protocol, ReadsFeedbackWithSignedExtremes) {
  const auto angles = DecodeJointAngles({0x2A6, 8, {0x80, 0, 0, 0, 0x7F, 0xFF, 0xFF, 0xFF}});
  ASSERT_TRUE(angles);
  EXPECT_EQ(angles->pair, 1);
  EXPECT_DOUBLE_EQ(angles->first, -2147483648.0 * kMilliDegree);
  EXPECT_DOUBLE_EQ(angles->second, 2147483647.0 * kMilliDegree);
  const auto speed = DecodeJointSpeed({0x256, 8, {0x80, 0, 0x7F, 0xFF}});
  ASSERT_TRUE(speed);
  EXPECT_EQ(speed->joint, 5);
  EXPECT_DOUBLE_EQ(speed->velocity, -32.768);
  EXPECT_DOUBLE_EQ(speed->current, 32.767);
  const auto gripper = DecodeGripperStatus({0x2A8, 8, {0, 0, 0x88, 0xB8, 0xFF, 0x06, 0xC4}});
  ASSERT_TRUE(gripper);
  EXPECT_DOUBLE_EQ(gripper->opening, 0.035);
  EXPECT_DOUBLE_EQ(gripper->effort, -0.250);
  EXPECT_TRUE(gripper->enabled);
  EXPECT_TRUE(gripper->homed);
  EXPECT_EQ(gripper->errors, 4);
  const auto driver =
      DecodeDriverStatus({0x261, 8, {0xFF, 0xFF, 0xFF, 0xF6, 0x80, 0x50, 0xFF, 0xFF}});
  ASSERT_TRUE(driver);
  EXPECT_DOUBLE_EQ(driver->supply_V, 6553.5);
  EXPECT_DOUBLE_EQ(driver->driver_temperature, -10);
  EXPECT_DOUBLE_EQ(driver->motor_temperature, -128);
  EXPECT_EQ(driver->bits, kEnabled | kCollisionProtection);
  EXPECT_DOUBLE_EQ(driver->bus_current, 65.535);
  const auto status = DecodeArmStatus({0x2A1, 8, {1, 7, 1, 0, 1, 9, 0x08, 0x21}});
  ASSERT_TRUE(status);
  EXPECT_EQ(status->code, StatusCode::kCollision);
  EXPECT_TRUE(status->moving);
  EXPECT_EQ(status->joint_limit, 0x08);
  EXPECT_EQ(status->joint_bus, 0x21);
  // As the vendor's protocol text has it: 0x473 of joint 2, 180.0 and 0 degrees, 3 rad/s.
  const auto limit = DecodeJointLimit({0x473, 8, {2, 0x07, 0x08, 0, 0, 0x01, 0x2C}});
  ASSERT_TRUE(limit);
  EXPECT_EQ(limit->joint, 1);
  EXPECT_DOUBLE_EQ(limit->upper, M_PI);
  EXPECT_DOUBLE_EQ(limit->max_speed, 3.0);
  const auto acceleration = DecodeJointAcceleration({0x47C, 8, {6, 0x01, 0xF4}});
  ASSERT_TRUE(acceleration);
  EXPECT_DOUBLE_EQ(acceleration->max_acceleration, 5.0);
}

TEST(Protocol, ReadsBackWhatItWrites) {
  RandomStream random(StreamKey("protocol test"));
  for (int i = 0; i < 2000; ++i) {
    const JointPair pair{i % 3, random.Uniform(-4, 4), random.Uniform(-4, 4)};
    for (const auto& back : {DecodeJointTargets(EncodeJointTargets(pair)),
                             DecodeJointAngles(EncodeJointAngles(pair))}) {
      ASSERT_TRUE(back);
      ASSERT_EQ(back->pair, pair.pair);
      ASSERT_NEAR(back->first, pair.first, 0.5001 * kMilliDegree);
      ASSERT_NEAR(back->second, pair.second, 0.5001 * kMilliDegree);
      ASSERT_EQ(back->first, RoundToWire(pair.first));
    }
    const auto pose = DecodeEndPose(EncodeEndPose(i % 3, pair.first / 10, pair.second / 10));
    ASSERT_TRUE(pose);
    ASSERT_NEAR(pose->first, pair.first / 10, 1e-5);
    const GripperTarget gripper{random.Uniform(0, 0.1), random.Uniform(0, 5), i % 2 == 0,
                                i % 3 == 0};
    const auto gripper_back = DecodeGripperTarget(Encode(gripper));
    ASSERT_NEAR(gripper_back->opening, gripper.opening, 0.6e-6);
    ASSERT_NEAR(gripper_back->effort, gripper.effort, 0.6e-3);
    ASSERT_EQ(gripper_back->enable, gripper.enable);
    ASSERT_EQ(gripper_back->clear_error, gripper.clear_error);
  }
}

TEST(Protocol, SaturatesWhatDoesNotFitAndSendsNoNaN) {
  const double infinity = std::numeric_limits<double>::infinity();
  const auto far = DecodeJointTargets(EncodeJointTargets({0, infinity, -infinity}));
  EXPECT_DOUBLE_EQ(far->first, 2147483647.0 * kMilliDegree);
  EXPECT_DOUBLE_EQ(far->second, -2147483648.0 * kMilliDegree);
  EXPECT_EQ(EncodeJointTargets({0, std::nan(""), 0}), (CanFrame{0x155, 8, {}}));
}

TEST(Protocol, ReadsNothingFromAnotherIdentifierOrLength) {
  // Every identifier with every decoder: none takes a frame of seven bytes, none throws.
  for (int id = 0; id <= kMaxCanId; ++id) {
    CanFrame frame{static_cast<uint16_t>(id), 7, {1, 1}};
    EXPECT_FALSE(DecodeStop(frame) || DecodeModeControl(frame) || DecodeJointTargets(frame) ||
                 DecodeGripperTarget(frame) || DecodeMotorPower(frame) || DecodeLimitQuery(frame) ||
                 DecodeParameterQuery(frame) || DecodeArmStatus(frame) || DecodeEndPose(frame) ||
                 DecodeJointAngles(frame) || DecodeGripperStatus(frame) ||
                 DecodeJointSpeed(frame) || DecodeDriverStatus(frame) || DecodeJointLimit(frame) ||
                 DecodeJointAcceleration(frame) || DecodeFirmwareText(frame))
        << id;
  }
  EXPECT_FALSE(DecodeJointLimit({0x473, 8, {0}}));
  EXPECT_FALSE(DecodeJointLimit({0x473, 8, {7}}));
  EXPECT_FALSE(DecodeMotorPower({0x471, 8, {8, 2}}));
  EXPECT_FALSE(DecodeMotorPower({0x471, 8, {1, 3}}));
  EXPECT_FALSE(DecodeModeControl({0x151, 8, {1, 1, 101}}));
}

TEST(CommandGuard, RefusesConfigurationWritesAndUnknownIdentifiersWithAnyConsent) {
  for (const Consent consent : {Consent::kMotion, Consent::kPowerOff}) {
    for (int id = 0; id <= kMaxCanId; ++id) {
      const bool known = id == 0x150 || id == 0x151 || (id >= 0x155 && id <= 0x157) ||
                         id == 0x159 || id == 0x471 || id == 0x472 || id == 0x477 || id == 0x4AF;
      const CanFrame ones{static_cast<uint16_t>(id), 8, {1, 1, 1, 1, 1, 1, 1, 1}};
      const CanFrame zeros{static_cast<uint16_t>(id), 8, {}};
      if (!known) {
        EXPECT_FALSE(CheckMaySend(ones, consent).ok()) << id;
        EXPECT_FALSE(CheckMaySend(zeros, consent).ok()) << id;
      }
    }
    for (const CanFrame& denied :
         std::vector<CanFrame>{{0x477, 8, {0, 1}},              // restore defaults
                               {0x477, 8, {0, 0, 0, 0xAE, 1}},  // load
                               {0x470, 8, {0xFA}},              // leader mode
                               {0x474, 8, {1, 0, 0, 0, 0, 1}},
                               {0x475, 8, {7, 0xAE}},  // zero of every joint
                               {0x47D, 8, {100, 70}},
                               Encode(GripperTarget{0, 0, true, false, true}),  // gripper's zero
                               {0x150, 8, {0, 0, 1}},                           // teaching
                               {0x151, 8, {2, 1, 50}},                          // teach mode
                               {0x151, 8, {1, 4, 50}},                          // torque mode
                               {0x151, 8, {1, 0, 50}},                          // Cartesian
                               {0x151, 8, {1, 1, 50, 0, 0, 2}},                 // mounting position
                               {0x15A, 8, {}},
                               {0x152, 8, {}}})
      EXPECT_FALSE(CheckMaySend(denied, consent).ok()) << denied.id;
  }
}

TEST(CommandGuard, LetsTheArmFallOnlyWithConsent) {
  for (const CanFrame& dangerous :
       {EncodeStop(Stop::kReset), Encode(MotorPower{7, false}), Encode(MotorPower{2, false}),
        Encode(GripperTarget{0, 1, false})}) {
    EXPECT_FALSE(CheckMaySend(dangerous, Consent::kMotion).ok());
    EXPECT_TRUE(CheckMaySend(dangerous, Consent::kPowerOff).ok());
  }
  EXPECT_TRUE(CheckMaySend(EncodeStop(Stop::kQuick), Consent::kMotion).ok());
}

TEST(JointAssembler, CompletesASampleWithItsOldestStamp) {
  JointAssembler assembler(3'000'000);
  EXPECT_FALSE(assembler.Add({0, 1, 2}, 100));
  EXPECT_FALSE(assembler.Add({1, 3, 4}, 200));
  const auto sample = assembler.Add({2, 5, 6}, 300);
  ASSERT_TRUE(sample);
  EXPECT_EQ(sample->q, (JointVector{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(sample->stamp_ns, 100);
  EXPECT_EQ(assembler.torn(), 0u);
}

TEST(JointAssembler, NeverMixesTwoSamplesWhateverFrameIsLost) {
  // Samples of 5 ms; sample k carries the value k in every joint. Each frame is lost with its own
  // chance, and arrivals jitter.
  RandomStream random(StreamKey("torn samples"));
  JointAssembler assembler(3'000'000);
  int complete = 0;
  for (int k = 0; k < 20000; ++k) {
    for (int pair = 0; pair < 3; ++pair) {
      if (random.Uniform() < 0.2) continue;
      const auto value = static_cast<double>(k);
      const int64_t stamp = 5'000'000LL * k + 130'000LL * pair + random.UniformInt(400'000);
      if (const auto sample = assembler.Add({pair, value, value}, stamp)) {
        ++complete;
        for (const double q : sample->q) ASSERT_EQ(q, sample->q[0]);
      }
    }
  }
  EXPECT_NEAR(complete, 20000 * 0.8 * 0.8 * 0.8, 400);
  EXPECT_GT(assembler.torn(), 5000u);
}

TEST(Firmware, IsReadFromTheTextOfSeveralFrames) {
  EXPECT_EQ(ParseFirmware("H-V1.2-1S-V1.8-4"), (Firmware{1, 8, 4}));
  EXPECT_EQ(ParseFirmware(std::string("\0\0S-V1.10-12\0", 13)), (Firmware{1, 10, 12}));
  for (const char* text : {"", "S-V", "S-V1.8", "S-V1.8-", "S-Vx.8-1", "V1.8-4", "S-V1-8-4"})
    EXPECT_FALSE(ParseFirmware(text)) << text;
  EXPECT_LT((Firmware{1, 8, 9}), (Firmware{1, 10, 0}));
  EXPECT_EQ(ZeroOf({1, 6, 2}), Zero::kBefore_1_6_3);
  EXPECT_EQ(ZeroOf({1, 6, 3}), Zero::kSince_1_6_3);
  EXPECT_EQ(CurrentScale({1, 8, 2}, 0), 4);
  EXPECT_EQ(CurrentScale({1, 8, 2}, 3), 1);
  EXPECT_EQ(CurrentScale({1, 8, 3}, 0), 1);
}

TEST(LimitCheck, NamesWhatDamagedFlashAnswers) {
  const JointAcceleration good{0, 5};
  EXPECT_TRUE(CheckJointLimit({0, -2.618, 2.618, 3}, good).ok());
  // pyAgxArm issue 55: both ends -0.1 degrees.
  const absl::Status same = CheckJointLimit({0, -0.0017, -0.0017, 3}, good);
  EXPECT_THAT(std::string(same.message()), HasSubstr("joint 1 answers upper = -0.0017 rad"));
  EXPECT_FALSE(CheckJointLimit({1, -1, 2, 3}, good).ok());        // beyond a stop
  EXPECT_FALSE(CheckJointLimit({0, -2.6, 2.6, 0.3}, good).ok());  // the other unit
  EXPECT_FALSE(CheckJointLimit({0, -2.6, 2.6, 30}, good).ok());
  EXPECT_THAT(std::string(CheckJointLimit({0, -2.6, 2.6, 3}, {0, 655.35}).message()),
              HasSubstr("max_acceleration = 655.35"));
}

struct Reference {
  Zero zero;
  JointVector q;
  std::array<double, 6> pose;  // [mm], [degrees]
};
// C_PiperForwardKinematics(dh_is_offset).CalFK(q) of piper_sdk 0.6.1.
const Reference kReferences[] = {
    {Zero::kSince_1_6_3, {}, {56.127512, 0, 213.266268, 0, 85, 0}},
    {Zero::kSince_1_6_3,
     {0.5, 1.2, -0.8, 0.3, -0.4, 1.1},
     {241.219328, 119.845517, 350.388272, 85.881100, 10.574849, 111.265825}},
    {Zero::kSince_1_6_3,
     {-2.0, 2.5, -2.2, -1.5, 1.1, -1.9},
     {-297.534987, -455.731169, 215.321243, 108.752402, -60.687110, -105.265569}},
    {Zero::kSince_1_6_3,
     {1.1, 0.3, -1.9, 1.2, 0.7, 0.4},
     {-183.118407, -239.324776, 561.412498, 9.868393, 37.003042, 155.752819}},
    {Zero::kBefore_1_6_3, {}, {54.952969, 0, 203.386924, 0, 85, 0}},
    {Zero::kBefore_1_6_3,
     {0.5, 1.2, -0.8, 0.3, -0.4, 1.1},
     {232.765102, 115.226953, 347.903135, 85.881100, 10.574849, 111.265825}},
    {Zero::kBefore_1_6_3,
     {1.1, 0.3, -1.9, 1.2, 0.7, 0.4},
     {-184.951674, -242.926706, 552.321502, 9.868393, 37.003042, 155.752819}}};

TEST(Kinematics, AgreesWithTheVendorsSdk) {
  for (const Reference& reference : kReferences) {
    const Eigen::Isometry3d T = ToolPose(reference.q, reference.zero);
    const Eigen::Vector3d angles = FixedAngles(T.linear());
    for (int i = 0; i < 3; ++i) {
      EXPECT_NEAR(1000 * T.translation()[i], reference.pose[i], 1e-5);
      EXPECT_NEAR(angles[i] * 180 / M_PI, reference.pose[3 + i], 1e-5);
    }
  }
}

TEST(Kinematics, JacobianIsTheDerivativeOfThePose) {
  const JointVector q = {0.4, 1.1, -0.9, 0.3, 0.5, -0.7};
  const auto J = ToolJacobian(q, Zero::kSince_1_6_3);
  const double step = 1e-6;
  for (int j = 0; j < kJoints; ++j) {
    JointVector up = q, down = q;
    up[j] += step;
    down[j] -= step;
    const Eigen::Isometry3d T_up = ToolPose(up, Zero::kSince_1_6_3),
                            T_down = ToolPose(down, Zero::kSince_1_6_3);
    const Eigen::Vector3d v = (T_up.translation() - T_down.translation()) / (2 * step);
    const Eigen::AngleAxisd turn(T_up.linear() * T_down.linear().transpose());
    EXPECT_LT((J.col(j).head<3>() - v).norm(), 1e-8);
    EXPECT_LT((J.col(j).tail<3>() - turn.axis() * turn.angle() / (2 * step)).norm(), 1e-8);
  }
}

TEST(SnapshotCell, HandsOutWholeValues) {
  struct Pair {
    int64_t a = 0;
    double b = 0;
    uint8_t c = 0;
  };
  SnapshotCell<Pair> cell;
  EXPECT_EQ(cell.Load().a, 0);
  cell.Store({7, 7.5, 3});
  EXPECT_EQ(cell.Load().a, 7);
  EXPECT_EQ(cell.Load().b, 7.5);
  EXPECT_EQ(cell.Load().c, 3);
}

}  // namespace
}  // namespace robostress::piper
