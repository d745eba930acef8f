#include "robot_client/piper/piper_arm.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/robot_client/piper/emulated_arm.h"
#include "tests/sim_worker/allocation_counter.h"

namespace robostress::piper {
namespace {

using ::testing::HasSubstr;

const JointVector kPose = {0.4, 0.9, -0.7, 0.2, 0.3, -0.5};

std::string Said(const absl::Status& status) { return std::string(status.message()); }

TEST(PiperArm, ConnectsAndReadsFirmwareAndLimits) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  EXPECT_EQ(world.arm->firmware(), (Firmware{1, 8, 9}));
  EXPECT_EQ(world.arm->description(), "piper on in-process, firmware S-V1.8-9");
  const ArmLimits limits = world.arm->limits();
  // The answer's 0.1 degrees lose at most 0.9 mrad; the margin is 5 mrad.
  EXPECT_NEAR(limits.upper[0], 2.6179 - 0.005, 1e-3);
  EXPECT_NEAR(limits.lower[1], 0.005, 1e-3);
  EXPECT_LE(limits.upper[2], 0);
  EXPECT_DOUBLE_EQ(limits.max_velocity[0], 3);
  EXPECT_DOUBLE_EQ(limits.max_acceleration[5], 5);
  EXPECT_EQ(limits.upper[6], 0.07);
  const ArmSnapshot snapshot = world.arm->Latest();
  EXPECT_GT(snapshot.sequence, 50u);
  EXPECT_FALSE(snapshot.enabled);
  EXPECT_EQ(snapshot.faults, 0u);
  EXPECT_LE(world.time.now_ns() - snapshot.stamp_ns, 6'000'000);
}

TEST(PiperArm, NeverEnablesByItself) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(world.Stream(Command(kPose), 1).ok());
  EXPECT_FALSE(world.arm->Latest().enabled);
  for (int j = 0; j < kJoints; ++j) EXPECT_NEAR(world.arm->Latest().position[j], 0, 0.01);
}

TEST(PiperArm, EnablesWithoutMovingAndFollowsTargets) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  EXPECT_EQ(world.arm->Send(Command({0, 0, 0, 0, 0, 9})).code(),
            absl::StatusCode::kInvalidArgument);
  ASSERT_TRUE(Enabled(world));
  EXPECT_TRUE(world.arm->Latest().enabled);
  for (int j = 0; j < kJoints; ++j) EXPECT_NEAR(world.arm->Latest().position[j], 0, 0.02);
  EXPECT_NEAR(world.arm->Latest().position[6], 0, 1e-3);  // the gripper was not asked
  ASSERT_TRUE(world.Stream(Command(kPose), 3).ok());
  const ArmSnapshot snapshot = world.arm->Latest();
  for (int j = 0; j < kJoints; ++j) {
    EXPECT_NEAR(snapshot.position[j], kPose[j], 0.0035) << j;  // 0.2 degrees
    EXPECT_NEAR(snapshot.velocity[j], 0, 0.01);
  }
  EXPECT_NEAR(snapshot.position[6], 0.03, 1e-3);
  EXPECT_EQ(snapshot.faults, 0u);
  // J2 carries the forearm: gravity's torque, from the current.
  EXPECT_NEAR(snapshot.effort[1], world.emulator->plant().reading().gravity[1], 0.8);
}

TEST(PiperArm, ReportsTheSameTorqueForOldFirmwareWithScaledCurrents) {
  EmulatorOptions old;
  old.version = {1, 8, 2};
  EmulatedArm world(old);
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  ASSERT_TRUE(world.Stream(Command(kPose), 3).ok());
  EXPECT_NEAR(world.arm->Latest().effort[1], world.emulator->plant().reading().gravity[1], 0.8);
}

TEST(PiperArm, RefusesSilence) {
  EmulatedArm world;
  world.emulator->firmware().SetSilent(true);
  const absl::Status status = world.arm->Connect();
  EXPECT_EQ(status.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(Said(status), HasSubstr("leader mode"));
  EXPECT_EQ(world.arm->Send(Command({})).code(), absl::StatusCode::kFailedPrecondition);
}

TEST(PiperArm, RefusesForeignCommandsAtStartAndReportsThemLater) {
  EmulatorOptions options;
  options.faults = {ParseFault("foreign@0.1+0.2").value()};
  EmulatedArm world(options);
  const absl::Status status = world.arm->Connect();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(Said(status), HasSubstr("0x155"));
  // The other program was stopped.
  ASSERT_TRUE(world.arm->Connect().ok());
  EXPECT_EQ(world.arm->Latest().faults, 0u);
  ASSERT_TRUE(world.third->Send(Encode(MotorPower{7, true})).ok());
  world.Run(0.01);
  EXPECT_EQ(world.arm->Latest().faults, kFaultForeignCommand);
}

TEST(PiperArm, RefusesOldFirmwareAndDamagedLimits) {
  EmulatorOptions options;
  options.version = {1, 4, 9};
  EmulatedArm old(options);
  EXPECT_THAT(Said(old.arm->Connect()), HasSubstr("S-V1.4-9 is older than S-V1.5-2"));

  EmulatedArm damaged;
  damaged.emulator->firmware().SetLimit({3, -0.00175, -0.00175, 3});
  const absl::Status status = damaged.arm->Connect();
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(Said(status), HasSubstr("joint 4 answers upper"));
}

TEST(PiperArm, RefusesAGripperThatWasNeverConfigured) {
  EmulatorOptions options;
  options.gripper_range = 0;
  EmulatedArm world(options);
  EXPECT_THAT(Said(world.arm->Connect()), HasSubstr("70 or 100 mm"));
  options.gripper_range = 0.1;
  EmulatedArm wide(options);
  ASSERT_TRUE(wide.arm->Connect().ok());
  EXPECT_EQ(wide.arm->limits().upper[6], 0.1);
}

TEST(PiperArm, NamesAJointThatDoesNotAnswer) {
  EmulatedArm world;
  world.emulator->firmware().SetJointSilent(2, true);
  EXPECT_THAT(Said(world.arm->Connect()), HasSubstr("joint 3 did not answer 0x472"));
}

TEST(PiperArm, KeepsTheLastWholeSampleWhileFramesAreLost) {
  EmulatorOptions options;
  options.faults = {ParseFault("tear@2+0.5").value()};
  EmulatedArm world(options);
  ASSERT_TRUE(world.arm->Connect().ok());
  world.Run(2.1 - 1e-9 * static_cast<double>(world.time.now_ns()));
  const uint64_t before = world.arm->Latest().sequence;
  world.Run(0.3);
  // Half the samples are torn; the others arrive.
  EXPECT_NEAR(static_cast<double>(world.arm->Latest().sequence - before), 30, 2);
  EXPECT_NEAR(static_cast<double>(world.arm->torn_samples()), 40, 12);
}

TEST(PiperArm, ShowsFaultsOfTheArmByName) {
  EmulatorOptions options;
  options.faults = {ParseFault("collision:J2@4").value(), ParseFault("motor-hot:J5@4.5").value()};
  EmulatedArm world(options);
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  ASSERT_TRUE(
      world.Stream(Command(kPose), 4.2 - 1e-9 * static_cast<double>(world.time.now_ns())).ok());
  world.Run(0.1);
  EXPECT_EQ(world.arm->Latest().faults, kFaultCollision);
  world.Run(0.6);
  EXPECT_EQ(world.arm->Latest().faults, kFaultCollision | kFaultOverTemperature);
  EXPECT_TRUE(world.arm->Latest().enabled);
}

TEST(PiperArm, SaysWhenEnableIsLost) {
  EmulatorOptions options;
  options.faults = {ParseFault("power-off:J3@3").value()};
  EmulatedArm world(options);
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  EXPECT_TRUE(world.arm->Latest().enabled);
  world.Run(3.1 - 1e-9 * static_cast<double>(world.time.now_ns()));
  EXPECT_FALSE(world.arm->Latest().enabled);
}

TEST(PiperArm, SnapshotGrowsOldWhenTheArmFallsSilent) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  world.emulator->firmware().SetSilent(true);
  const uint64_t before = world.arm->Latest().sequence;
  world.Run(0.25);
  EXPECT_LE(world.arm->Latest().sequence, before + 1);
  EXPECT_GE(world.time.now_ns() - world.arm->Latest().stamp_ns, 245'000'000);
  EXPECT_EQ(world.arm->Latest().faults, 0u) << "silence is no missing status";
  EXPECT_FALSE(world.arm->Latest().enabled);
}

TEST(PiperArm, QuickStopSinksAndOnlyDisableAndEnableBringTheArmBack) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  const JointVector stretched = {0.4, 1.6, -1.1, 0.2, 0.3, -0.5};
  ASSERT_TRUE(world.Stream(Command(stretched), 3).ok());
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(world.arm->QuickStop().ok());
    world.Run(0.01);
  }
  EXPECT_EQ(world.arm->Send(Command(kPose)).code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_EQ(world.arm->Latest().faults, kFaultEmergencyStop);
  const double before = world.arm->Latest().position[1];
  world.Run(0.3);
  EXPECT_GT(std::abs(world.arm->Latest().position[1] - before), 0.01);  // it sinks
  EXPECT_LT(std::abs(world.arm->Latest().velocity[1]), 1.0);            // slowly
  EXPECT_EQ(world.arm->Enable().code(), absl::StatusCode::kFailedPrecondition);
  ASSERT_TRUE(world.arm->Disable().ok());
  EXPECT_FALSE(world.arm->Latest().enabled);
  EXPECT_THAT(Said(world.arm->Enable()), HasSubstr("moves at")) << "it falls";
  world.Run(3);
  ASSERT_TRUE(Enabled(world));
  EXPECT_TRUE(world.arm->Latest().enabled);
  EXPECT_EQ(world.arm->Latest().faults, 0u);
}

// Frames that command or configure an arm, of everybody on the bus since the last call.
int Commands(EmulatedArm& world) {
  int commands = 0;
  for (StampedFrame received; world.third->Receive(received);)
    commands += IsCommand(received.frame) ? 1 : 0;
  return commands;
}

TEST(PiperArm, IsNotEnabledOnAnOldPoseAndHearsNothingOfIt) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  world.emulator->firmware().SetSilent(true);
  world.Run(0.1);
  Commands(world);
  const absl::Status refused = world.arm->Enable();
  EXPECT_TRUE(absl::IsUnavailable(refused)) << refused;
  EXPECT_THAT(Said(refused), HasSubstr("the newest joint sample is 1"));
  EXPECT_EQ(Commands(world), 0);
}

TEST(PiperArm, ASecondClientSendsNotOneTarget) {
  EmulatedArm world;
  PiperArm second(world.bus.Attach(), world.time);
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(second.Connect().ok());
  ASSERT_TRUE(Enabled(world));
  ASSERT_TRUE(world.Stream(Command(kPose), 0.2).ok());
  Commands(world);
  const absl::Status refused = second.Enable();
  EXPECT_TRUE(absl::IsFailedPrecondition(refused)) << refused;
  EXPECT_THAT(Said(refused), HasSubstr("another sender commands this arm"));
  EXPECT_EQ(Commands(world), 0);
}

TEST(PiperArm, ASenderThatBeginsWhileEnableListensIsHeard) {
  EmulatorOptions options;
  options.faults = {ParseFault("foreign@0.6+0.3").value()};
  EmulatedArm world(options);
  ASSERT_TRUE(world.arm->Connect().ok());  // 0.5 s
  Commands(world);
  const int64_t began = world.time.now_ns();
  const absl::Status refused = world.arm->Enable();
  EXPECT_THAT(Said(refused), HasSubstr("another sender")) << refused;
  EXPECT_LT(world.time.now_ns() - began, 160'000'000);
  int own = 0;
  for (StampedFrame received; world.third->Receive(received);)
    own += received.frame.id == kModeControl || received.frame.id == kMotorPower ? 1 : 0;
  EXPECT_EQ(own, 0);
}

TEST(PiperArm, ASenderThatIsGoneForASecondIsForgottenWhenAPersonHasSeenIt) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(world.third->Send(EncodeJointTargets({0, 0, 0})).ok());
  world.Run(0.9);
  EXPECT_EQ(world.arm->Latest().faults, kFaultForeignCommand);
  world.arm->Acknowledge();
  world.Run(0.05);
  EXPECT_EQ(world.arm->Latest().faults, kFaultForeignCommand) << "not for long enough";
  world.Run(0.1);
  EXPECT_EQ(world.arm->Latest().faults, kFaultForeignCommand) << "nobody has seen it";
  world.arm->Acknowledge();
  world.Run(0.05);
  EXPECT_EQ(world.arm->Latest().faults, 0u);
  EXPECT_TRUE(Enabled(world));
}

TEST(PiperArm, AStatusThatStopsIsUnknownOrOfAnotherModeIsAFault) {
  const std::pair<const char*, uint32_t> cases[] = {{"status-silent", kFaultStatus},
                                                    {"status-unknown", kFaultStatus},
                                                    {"standby", kFaultMode},
                                                    {"teach", kFaultMode}};
  for (const auto& [kind, fault] : cases) {
    EmulatorOptions options;
    options.faults = {ParseFault(std::string(kind) + "@3+0.6").value()};
    EmulatedArm world(options);
    ASSERT_TRUE(world.arm->Connect().ok());
    ASSERT_TRUE(Enabled(world));
    world.Run(2.95 - 1e-9 * static_cast<double>(world.time.now_ns()));
    EXPECT_EQ(world.arm->Latest().faults, 0u) << kind;
    world.Run(0.35);
    EXPECT_EQ(world.arm->Latest().faults, fault) << kind;
    world.Run(0.5);
    EXPECT_EQ(world.arm->Latest().faults, 0u) << kind << ": the arm itself is well again";
  }
}

TEST(PiperArm, NamesTheJointWhoseDriverHasAFault) {
  EmulatorOptions options;
  options.faults = {ParseFault("driver-error:J4@3").value()};
  EmulatedArm world(options);
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  world.Run(3.1 - 1e-9 * static_cast<double>(world.time.now_ns()));
  const ArmSnapshot arm = world.arm->Latest();
  EXPECT_THAT(ArmFaultNames(arm.faults, arm.fault_joints), HasSubstr("driver or sensor error"));
  EXPECT_THAT(ArmFaultNames(arm.faults, arm.fault_joints), HasSubstr("(J4)"));
}

TEST(PiperArm, ReadsAndWritesTheArmsOwnCollisionProtection) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  EXPECT_FALSE(world.arm->collision_levels().has_value()) << "not asked";
  ASSERT_TRUE(world.arm->AskCollisionLevels().ok());
  EXPECT_EQ(world.arm->collision_levels(), (std::array<int, kJoints>{})) << "off, as delivered";
  ASSERT_TRUE(world.arm->SetCollisionLevel(5).ok());
  EXPECT_EQ(world.arm->collision_levels(), (std::array<int, kJoints>{5, 5, 5, 5, 5, 5}));
  EXPECT_TRUE(absl::IsInvalidArgument(world.arm->SetCollisionLevel(9)));
  const CanFrame write = EncodeCollisionWrite({5, 5, 5, 5, 5, 5});
  for (const Consent consent : {Consent::kMotion, Consent::kPowerOff})
    EXPECT_FALSE(CheckMaySend(write, consent).ok()) << "only on a person's word";
  EXPECT_FALSE(CheckMaySend(EncodeCollisionWrite({9, 0, 0, 0, 0, 0}), Consent::kSettings).ok());
}

TEST(PiperArm, TheArmsOwnSpeedFollowsTheLimitThatIsConfigured) {
  EXPECT_EQ(PercentOf(3), 100);
  EXPECT_EQ(PercentOf(1), 37);
  EXPECT_EQ(PercentOf(0.2), 8);
  EXPECT_EQ(PercentOf(1e-6), 1);
  EmulatedArm world({}, {.speed_percent = PercentOf(0.2)});
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  const double before = world.arm->Latest().position[0];
  ASSERT_TRUE(world.Stream(Command({before + 1, 0.9, -0.7, 0.2, 0.3, -0.5}), 1).ok());
  EXPECT_LT(world.arm->Latest().position[0] - before, 0.25) << "whatever is sent";
  EXPECT_GT(world.arm->Latest().position[0] - before, 0.15);
}

// A bus that takes nothing from some moment on, and says so by a code alone.
class StuckBus : public CanBus {
 public:
  StuckBus(std::unique_ptr<CanBus> bus, const bool* stuck) : bus_(std::move(bus)), stuck_(stuck) {}
  absl::Status Open() override { return bus_->Open(); }
  absl::Status Send(const CanFrame& frame) override {
    return *stuck_ ? absl::UnavailableError("") : bus_->Send(frame);
  }
  bool Receive(StampedFrame& frame) override { return bus_->Receive(frame); }
  CanHealth health() const override { return bus_->health(); }
  std::string description() const override { return bus_->description(); }

 private:
  const std::unique_ptr<CanBus> bus_;
  const bool* const stuck_;
};

TEST(PiperArm, SaysWhatIsWrongWithABusThatTakesNothing) {
  EmulatedArm world;
  bool stuck = false;
  PiperArm arm(std::make_unique<StuckBus>(world.bus.Attach(), &stuck), world.time);
  ASSERT_TRUE(arm.Connect().ok());
  stuck = true;
  EXPECT_THAT(Said(arm.Enable()), HasSubstr("the bus does not take a frame"));
  EXPECT_THAT(Said(arm.Connect()), HasSubstr("in-process"));
}

TEST(PiperArm, AnEnableThatIsCancelledEndsAtOnce) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  for (const int64_t after_ns : {50'000'000LL, 250'000'000LL}) {
    const int64_t began = world.time.now_ns();
    const absl::Status cancelled =
        world.arm->Enable([&] { return world.time.now_ns() - began >= after_ns; });
    EXPECT_TRUE(absl::IsCancelled(cancelled)) << cancelled;
    EXPECT_LE(world.time.now_ns() - began, after_ns + 2'000'000);
  }
}

TEST(PiperArm, SendsOnlyFramesOfTheAllowedList) {
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  ASSERT_TRUE(world.Stream(Command(kPose), 1).ok());
  ASSERT_TRUE(world.arm->QuickStop().ok());
  world.Run(0.1);
  StampedFrame frame;
  int commands = 0;
  while (world.third->Receive(frame)) {
    if (!IsCommand(frame.frame)) continue;
    ++commands;
    EXPECT_TRUE(CheckMaySend(frame.frame, Consent::kMotion).ok()) << frame.frame.id;
  }
  EXPECT_GT(commands, 100);
}

TEST(PiperArm, AllocatesNothingInTheLoop) {
  if (!CountsAllocations()) GTEST_SKIP() << "a sanitizer owns malloc";
  EmulatedArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  const ArmCommand command = Command(kPose), refused = Command({0, 0, 0, 0, 0, 9});
  long counted = 0;
  for (int tick = 0; tick < 60; ++tick) {
    const long before = Allocations();
    world.arm->Poll();
    const ArmSnapshot snapshot = world.arm->Latest();
    const bool sent = world.arm->Send(command).ok();
    const bool denied = !world.arm->Send(refused).ok();
    counted += Allocations() - before;
    EXPECT_TRUE(sent && denied && snapshot.sequence > 0);
    world.Run(1.0 / 30);
  }
  ASSERT_TRUE(world.arm->QuickStop().ok());
  const long before = Allocations();
  (void)world.arm->QuickStop();
  (void)world.arm->Send(command);  // refused after a stop
  EXPECT_EQ(Allocations(), before);
  EXPECT_EQ(counted, 0);
}

}  // namespace
}  // namespace robostress::piper
