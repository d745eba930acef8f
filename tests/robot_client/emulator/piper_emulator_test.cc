#include "robot_client/emulator/piper_emulator.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>

#include "common/random.h"
#include "robot_client/emulator/joint_planner.h"
#include "tests/robot_client/piper/emulated_arm.h"

namespace robostress::piper {
namespace {

using ::testing::HasSubstr;

const JointVector kPose = {0.4, 0.9, -0.7, 0.2, 0.3, -0.5};

TEST(PiperMjcf, StandsWhereTheSdksKinematicsSay) {
  const auto plant = PiperPlant::Create(ComposePiperScene({}), {}).value();
  const int tool = mj_name2id(&plant->model(), mjOBJ_SITE, "piper_tool");
  ASSERT_GE(tool, 0);
  RandomStream random(StreamKey("piper kinematics"));
  for (int i = 0; i < 200; ++i) {
    JointVector q;
    for (int j = 0; j < kJoints; ++j)
      q[j] = random.Uniform(kJointRanges[j].lower, kJointRanges[j].upper);
    plant->Reset(q, 0.02);
    const Eigen::Isometry3d T = ToolPose(q, Zero::kSince_1_6_3);
    const Eigen::Map<const Eigen::Vector3d> p(plant->data().site_xpos + 3 * tool);
    const Eigen::Map<const Eigen::Matrix<double, 3, 3, Eigen::RowMajor>> R(plant->data().site_xmat +
                                                                           9 * tool);
    ASSERT_LT((p - T.translation()).norm(), 1e-4);  // 0.1 mm
    ASSERT_LT((R - T.linear()).norm(), 1e-6);
  }
}

TEST(PiperMjcf, WeighsWhatTheVendorSays) {
  const auto plant = PiperPlant::Create(ComposePiperScene({}), {}).value();
  EXPECT_NEAR(
      plant->model().body_subtreemass[mj_name2id(&plant->model(), mjOBJ_BODY, "piper_base")], 4.903,
      0.01);
  PiperScene loaded;
  loaded.payload_kg = 1.5;
  const auto heavy = PiperPlant::Create(ComposePiperScene(loaded), {}).value();
  plant->Reset(kPose, 0);
  heavy->Reset(kPose, 0);
  // The controller's gravity model does not know the payload.
  for (int j = 0; j < kJoints; ++j)
    EXPECT_NEAR(plant->reading().gravity[j], heavy->reading().gravity[j], 1e-9);
}

TEST(PiperMjcf, NamesWhatMuJoCoRefuses) {
  PiperScene scene;
  scene.world_xml = "<geom type=\"nosuch\"/>";
  const auto plant = PiperPlant::Create(ComposePiperScene(scene), {});
  ASSERT_FALSE(plant.ok());
  EXPECT_THAT(std::string(plant.status().message()), HasSubstr("nosuch"));
}

TEST(JointPlanner, ReachesATargetInTheTimeOfItsTrapezoid) {
  JointPlanner planner;
  planner.Reset(0);
  planner.SetTarget(2);
  int steps = 0;
  double fastest = 0;
  while (!planner.at_target() && steps < 5000) {
    const double before = planner.velocity();
    planner.Step(1.5, 5, 0.001);
    EXPECT_LE(std::abs(planner.velocity() - before),
              5e-3 * (1 + 1e-9) + (planner.at_target() ? 6e-3 : 0));
    fastest = std::max(fastest, planner.velocity());
    EXPECT_LE(planner.position(), 2 + 1e-5);  // less than the wire's resolution
    ++steps;
  }
  EXPECT_NEAR(fastest, 1.5, 1e-9);
  // Distance over speed plus speed over acceleration: 2 / 1.5 + 1.5 / 5 s.
  EXPECT_NEAR(steps * 0.001, 2 / 1.5 + 1.5 / 5, 0.01);
}

TEST(JointPlanner, FollowsARampAtTheDistanceThatBrakingNeeds) {
  JointPlanner planner;
  planner.Reset(0);
  for (int i = 0; i < 3000; ++i) {
    planner.SetTarget(0.5 * 0.001 * i);
    planner.Step(3, 5, 0.001);
  }
  EXPECT_NEAR(planner.velocity(), 0.5, 0.01);
  EXPECT_NEAR(planner.target() - planner.position(), 0.5 * 0.5 / (2 * 5), 0.002);
}

TEST(JointPlanner, HoldsWithinItsBrakingDistance) {
  JointPlanner planner;
  planner.Reset(0);
  planner.SetTarget(3);
  for (int i = 0; i < 400; ++i) planner.Step(3, 5, 0.001);
  const double v = planner.velocity(), p = planner.position();
  for (int i = 0; i < 1000; ++i) {
    planner.Brake(5, 0.001);
  }
  EXPECT_EQ(planner.velocity(), 0);
  EXPECT_NEAR(planner.position() - p, v * v / 10, 0.005);
}

TEST(PiperEmulator, SendsEveryFeedbackFrameAtItsRate) {
  EmulatedArm world;
  StampedFrame frame;
  while (world.third->Receive(frame)) {
  }
  std::map<int, int> counts;
  for (int i = 0; i < 1000; ++i) {
    world.Run(0.001);
    while (world.third->Receive(frame)) ++counts[frame.frame.id];
  }
  int total = 0;
  for (const auto& [id, count] : counts) {
    EXPECT_EQ(count, id >= 0x261 && id <= 0x266 ? 40 : 200) << id;
    total += count;
  }
  EXPECT_EQ(counts.size(), 20u);
  EXPECT_EQ(total, 3040);
}

TEST(PiperEmulator, MovesGripperAndReportsIt) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok() && world.arm->Enable().ok());
  for (const double opening : {0.06, 0.01, 0.0}) {
    ASSERT_TRUE(world.Stream(Command(kPose, opening), 1).ok());
    EXPECT_NEAR(world.arm->Latest().position[6], opening, 1e-3);
  }
}

TEST(PiperEmulator, StopsFollowingATargetBeyondALimitUntilItIsWithdrawn) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok() && world.arm->Enable().ok());
  ASSERT_TRUE(world.Stream(Command(kPose), 3).ok());
  // Past the client, as another program would.
  ASSERT_TRUE(world.third->Send(EncodeJointTargets({1, 0.1, 0.2})).ok());
  ASSERT_TRUE(world.third->Send(EncodeJointTargets({0, 3.0, 1.0})).ok());
  world.Run(0.5);
  EXPECT_EQ(world.arm->Latest().faults,
            kFaultTargetLimit | kFaultJointLimit | kFaultForeignCommand);
  EXPECT_EQ(world.emulator->firmware().status().joint_limit, 1 << 0 | 1 << 2);
  for (int j = 0; j < kJoints; ++j) EXPECT_NEAR(world.arm->Latest().position[j], kPose[j], 0.01);
  ASSERT_TRUE(world.Stream(Command(kPose), 0.5).ok());
  EXPECT_EQ(world.arm->Latest().faults, uint32_t{kFaultForeignCommand});
}

TEST(PiperEmulator, GoesToAPoseAndNamesOneThatItCannotReach) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok() && world.arm->Enable().ok());
  ASSERT_TRUE(world.Stream(Command(kPose), 3).ok());
  const Eigen::Isometry3d T = ToolPose(kPose, Zero::kSince_1_6_3);
  const Eigen::Vector3d rpy = FixedAngles(T.linear());
  const auto go = [&](const Eigen::Vector3d& p) {
    ASSERT_TRUE(world.third->Send(Encode(ModeControl{ControlMode::kCan, MoveMode::kP, 50})).ok());
    CanFrame frames[3] = {EncodeEndPose(0, p.x(), p.y()), EncodeEndPose(1, p.z(), rpy[0]),
                          EncodeEndPose(2, rpy[1], rpy[2])};
    for (CanFrame& frame : frames) {
      frame.id = static_cast<uint16_t>(frame.id - kEndPose + 0x152);
      ASSERT_TRUE(world.third->Send(frame).ok());
    }
    world.Run(2);
  };
  const Eigen::Vector3d near = T.translation() + Eigen::Vector3d(0.03, -0.04, 0.02);
  go(near);
  const Eigen::Isometry3d there =
      ToolPose(world.emulator->plant().link_angles(), Zero::kSince_1_6_3);
  EXPECT_LT((there.translation() - near).norm(), 0.005);
  EXPECT_LT((there.linear() - T.linear()).norm(), 0.02);
  go({2, 0, 0});
  EXPECT_EQ(world.emulator->firmware().status().code, StatusCode::kNoSolution);
}

TEST(OtherModes, ReadsTheTorqueModesPackedFields) {
  // JointMitCtrl(2, 0.5, 1.0, 10, 0.8, 2.0) of piper_sdk 0.6.1.
  const auto mit = DecodeMitTarget({0x15B, 8, {0x85, 0x1E, 0x82, 0xD0, 0x51, 0x94, 0x79, 0xF5}});
  ASSERT_TRUE(mit);
  EXPECT_EQ(mit->joint, 1);
  EXPECT_NEAR(mit->position, 0.5, 25.0 / 65535);
  EXPECT_NEAR(mit->velocity, 1.0, 90.0 / 4095);
  EXPECT_NEAR(mit->kp, 10, 500.0 / 4095);
  EXPECT_NEAR(mit->kd, 0.8, 10.0 / 4095);
  EXPECT_NEAR(mit->feedforward, 2.0, 16.0 / 255);
  CanFrame damaged{0x15B, 8, {0x85, 0x1E, 0x82, 0xD0, 0x51, 0x94, 0x79, 0xF5}};
  damaged.data[0] ^= 1;
  EXPECT_FALSE(DecodeMitTarget(damaged));
}

TEST(PiperEmulator, NeedsTwoEnablesAfterAReset) {
  EmulatedArm world;
  ASSERT_TRUE(world.third->Send(EncodeStop(Stop::kReset)).ok());
  ASSERT_TRUE(world.third->Send(Encode(MotorPower{7, true})).ok());
  world.Run(0.1);
  EXPECT_FALSE(world.emulator->firmware().enabled(0));
  ASSERT_TRUE(world.third->Send(Encode(MotorPower{7, true})).ok());
  world.Run(0.1);
  for (int j = 0; j < kJoints; ++j) EXPECT_TRUE(world.emulator->firmware().enabled(j));
}

TEST(PiperEmulator, FallsWhenItsPowerIsTakenOff) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok() && world.arm->Enable().ok());
  ASSERT_TRUE(world.Stream(Command({0, 1.2, -1.0, 0, 0, 0}), 3).ok());
  const double before = world.arm->Latest().position[1];
  ASSERT_TRUE(world.arm->Disable().ok());
  world.Run(0.5);
  EXPECT_GT(std::abs(world.arm->Latest().position[1] - before), 0.3);
}

TEST(PiperEmulator, AppliesTheCommandLag) {
  const auto moved_after = [](double lag_s) {
    EmulatorOptions options;
    options.command_lag_s = lag_s;
    EmulatedArm world(options);
    EXPECT_TRUE(world.arm->Connect().ok() && world.arm->Enable().ok());
    EXPECT_TRUE(world.Stream(Command(kPose), 3).ok());
    JointVector next = kPose;
    next[0] += 0.2;
    const double start = world.arm->Latest().position[0];
    EXPECT_TRUE(world.arm->Send(Command(next)).ok());
    for (int ms = 1; ms < 1000; ++ms) {
      world.Run(0.001);
      if (world.arm->Latest().position[0] > start + 0.005) return ms;
    }
    return 1000;
  };
  EXPECT_NEAR(moved_after(0.15) - moved_after(0.05), 100, 6);
}

TEST(PiperEmulator, PayloadMakesTheArmSagAndItsIntegratorTakesItUp) {
  PiperScene scene;
  scene.payload_kg = 1.0;
  EmulatorOptions options;
  options.scene = scene;
  EmulatedArm loaded(options), empty;
  for (EmulatedArm* world : {&loaded, &empty}) {
    ASSERT_TRUE(world->arm->Connect().ok() && world->arm->Enable().ok());
    ASSERT_TRUE(world->Stream(Command(kPose), 4).ok());
  }
  // Within 0.2 degrees, as an arm that carries 4.6 Nm was measured (piper_sdk issue 119), but with
  // the payload's torque.
  EXPECT_NEAR(loaded.arm->Latest().position[1], kPose[1], 0.0035);
  EXPECT_GT(std::abs(loaded.arm->Latest().effort[1]), std::abs(empty.arm->Latest().effort[1]) + 2);
}

TEST(PiperPlant, MotorEncodersDoNotSeeWhatTheTransmissionDoes) {
  WearProfile soft;
  soft.effects = {{1, "compliance", {100, 15, 0.7}}};
  const auto at_link = PiperPlant::Create(ComposePiperScene({}), soft).value();
  soft.motor_encoders = true;
  const auto at_motor = PiperPlant::Create(ComposePiperScene({}), soft).value();
  for (PiperPlant* plant : {at_link.get(), at_motor.get()}) plant->Reset(kPose, 0);
  const double bent = -at_link->reading().gravity[1] / 100;
  EXPECT_GT(std::abs(bent), 0.005);
  EXPECT_NEAR(at_link->reading().q[1], kPose[1], 1e-9);
  EXPECT_NEAR(at_link->reading().q[1] - at_motor->reading().q[1], bent, 1e-3);
}

TEST(PiperEmulator, IsDeterministic) {
  EmulatedArm one, two;
  for (EmulatedArm* world : {&one, &two}) {
    ASSERT_TRUE(world->arm->Connect().ok() && world->arm->Enable().ok());
    ASSERT_TRUE(world->Stream(Command(kPose), 1).ok());
  }
  EXPECT_EQ(one.arm->Latest().position, two.arm->Latest().position);
  EXPECT_EQ(one.arm->Latest().stamp_ns, two.arm->Latest().stamp_ns);
}

TEST(PiperEmulator, SkipsTimeInWhichTheMachineWasBusy) {
  EmulatedArm world;
  const uint64_t before = world.emulator->steps();
  world.emulator->RunUntil(world.time.now_ns() + 5'000'000'000);
  EXPECT_LE(world.emulator->steps() - before, 2u);
  EXPECT_NEAR(static_cast<double>(world.emulator->skipped_steps()), 5000, 2);
}

TEST(WearProfile, UsedArmHasMoreFrictionAndBacklashAtEveryJoint) {
  const WearProfile fresh = MakeWearProfile("new").value();
  const WearProfile used = MakeWearProfile("used_one_year").value();
  ASSERT_EQ(fresh.effects.size(), used.effects.size());
  for (size_t i = 0; i < fresh.effects.size(); ++i) {
    EXPECT_EQ(fresh.effects[i].type, used.effects[i].type);
    if (fresh.effects[i].type == "compliance") {
      EXPECT_GT(fresh.effects[i].values[0], used.effects[i].values[0]);
    } else {
      EXPECT_LT(fresh.effects[i].values[0], used.effects[i].values[0]);
    }
  }
  EXPECT_THAT(std::string(MakeWearProfile("worn").status().message()), HasSubstr("used_one_year"));
}

TEST(WearProfile, UsedArmFollowsASlowReversalWorse) {
  const auto lost_motion = [](const std::string& profile) {
    EmulatorOptions options;
    options.profile = profile;
    EmulatedArm world(options);
    EXPECT_TRUE(world.arm->Connect().ok() && world.arm->Enable().ok());
    EXPECT_TRUE(world.Stream(Command(kPose), 3).ok());
    double squares = 0;
    for (int tick = 0; tick < 120; ++tick) {
      JointVector q = kPose;
      for (int j = 0; j < kJoints; ++j) q[j] += 0.03 * std::sin(2 * M_PI * tick / 60.0);
      EXPECT_TRUE(world.arm->Send(Command(q)).ok());
      world.Run(1.0 / 30);
      for (int j = 0; j < kJoints; ++j)
        squares += std::pow(world.arm->Latest().position[j] - q[j], 2);
    }
    return std::sqrt(squares / 120 / kJoints);
  };
  EXPECT_GT(lost_motion("used_one_year"), 1.02 * lost_motion("new"));
}

TEST(FaultPlan, SaysWhatIsWrongWithAFault) {
  const auto fault = ParseFault("silent@4+0.5").value();
  EXPECT_EQ(fault.kind, FaultKind::kSilent);
  EXPECT_EQ(fault.at_s, 4);
  EXPECT_EQ(fault.for_s, 0.5);
  for (const char* text : {"", "silent", "nosuch@1", "collision@1", "silent:J1@1", "stall:J7@1",
                           "stall:J2@x", "silent@-1", "silent@1+2+3", "silent@nan"})
    EXPECT_FALSE(ParseFault(text).ok()) << text;
}

}  // namespace
}  // namespace robostress::piper
