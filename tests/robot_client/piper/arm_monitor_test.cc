#include "robot_client/piper/arm_monitor.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <set>

#include "nlohmann/json.hpp"
#include "robot_client/piper/arm_report_text.h"
#include "tests/robot_client/piper/emulated_arm.h"

namespace robostress::piper {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

// Keeps what is sent through it.
class RecordingBus : public CanBus {
 public:
  RecordingBus(std::unique_ptr<CanBus> bus, std::vector<CanFrame>* sent)
      : bus_(std::move(bus)), sent_(sent) {}
  absl::Status Open() override { return bus_->Open(); }
  absl::Status Send(const CanFrame& frame) override {
    sent_->push_back(frame);
    return bus_->Send(frame);
  }
  bool Receive(StampedFrame& frame) override { return bus_->Receive(frame); }
  CanHealth health() const override { return bus_->health(); }
  std::string description() const override { return bus_->description(); }

 private:
  const std::unique_ptr<CanBus> bus_;
  std::vector<CanFrame>* const sent_;
};

// An emulated arm, a client of ours and a monitor on one bus.
struct MonitoredArm : EmulatedArm {
  explicit MonitoredArm(const EmulatorOptions& options = {}, bool silent = false)
      : EmulatedArm(options) {
    ArmMonitorOptions monitor_options;
    monitor_options.silent = silent;
    monitor = std::make_unique<ArmMonitor>(std::make_unique<RecordingBus>(bus.Attach(), &sent),
                                           time, monitor_options);
    EXPECT_TRUE(monitor->Open().ok());
  }
  // Both poll as often as they should; `arm` takes part in nothing before its Connect.
  void Watch(double seconds) {
    const int64_t end_ns = time.now_ns() + static_cast<int64_t>(1e9 * seconds);
    while (time.now_ns() < end_ns) {
      time.SleepUntil(std::min(end_ns, time.now_ns() + 2'000'000));
      monitor->Poll();
      arm->Poll();
    }
  }
  ArmReport Report(double seconds) {
    Watch(seconds);
    return monitor->TakeReport();
  }

  std::vector<CanFrame> sent;  // by the monitor
  std::unique_ptr<ArmMonitor> monitor;
};

std::string Said(const ArmReport& report) {
  std::string text;
  for (const Finding& finding : Diagnose(report))
    text += (finding.error ? "WRONG " : "WARNING ") + finding.text + "\n";
  return text;
}

TEST(AgeStatistics, IsASawToothForRegularSamples) {
  AgeStatistics age;
  // Complete 1 ms after they were measured, every 5 ms: the age runs from 1 to 6 ms.
  for (int64_t i = 0; i <= 200; ++i) age.Add(5'000'000 * i, 5'000'000 * i + 1'000'000);
  EXPECT_NEAR(age.summary().mean_s, 0.0035, 1e-9);
  EXPECT_NEAR(age.summary().p99_s, 0.00595, 1e-4);  // a bin
  EXPECT_NEAR(age.summary().worst_s, 0.006, 1e-9);
  EXPECT_EQ(age.newest_stamp_ns(), 1'000'000'000);
  // Silence ages: of 1 s with samples and 1 s without, the mean is (3.5 ms + 0.501 s) / 2.
  age.Until(2'001'000'000);
  EXPECT_NEAR(age.summary().mean_s, (0.0035 + 0.501) / 2, 1e-6);
  EXPECT_NEAR(age.summary().worst_s, 1.001, 1e-9);
  age.Reset();
  EXPECT_EQ(age.summary().worst_s, 0);
  age.Until(2'002'000'000);
  EXPECT_NEAR(age.summary().worst_s, 1.002, 1e-9);  // what is old stays old
}

TEST(ArmMonitor, SeesEverythingOfAnArmAtRest) {
  MonitoredArm world;
  const ArmReport report = world.Report(1.2);
  ASSERT_TRUE(report.firmware.has_value());
  EXPECT_EQ(*report.firmware, (Firmware{1, 8, 9}));
  EXPECT_EQ(report.questions.answered, 15);
  EXPECT_EQ(report.questions.questions, 15);
  // The emulator answers with the next of its steps of 1 ms; this monitor looks every 2 ms, but the
  // stamps are the bus's.
  EXPECT_GT(report.questions.mean_s, 0);
  EXPECT_LE(report.questions.worst_s, 0.003);
  EXPECT_NEAR(report.samples_per_second, 200, 3);
  EXPECT_EQ(report.torn, 0u);
  EXPECT_NEAR(report.age.mean_s, 0.0025, 0.0006);
  EXPECT_LE(report.age.worst_s, 0.0061);
  ASSERT_EQ(report.reports.size(), 20u);
  double total = 0;
  for (const FrameCount& count : report.reports) {
    EXPECT_NEAR(count.per_second, count.expected, 0.02 * count.expected + 1) << count.id;
    total += count.per_second;
  }
  EXPECT_NEAR(total, 3040, 30);
  EXPECT_THAT(report.unknown, IsEmpty());
  for (const JointReport& joint : report.joints) {
    ASSERT_TRUE(joint.angle && joint.motion && joint.driver && joint.limit && joint.acceleration);
    EXPECT_NEAR(*joint.angle, 0, 0.01);
    EXPECT_NEAR(joint.driver->supply_V, 24, 0.5);
    EXPECT_EQ(joint.driver->bits & kEnabled, 0);
    EXPECT_NEAR(joint.acceleration->max_acceleration, 5, 1e-9);
    EXPECT_FALSE(joint.target.has_value());
  }
  EXPECT_NEAR(report.joints[0].limit->upper, 2.618, 0.001);
  EXPECT_NEAR(*report.gripper_range, 0.07, 1e-9);
  ASSERT_TRUE(report.status.has_value());
  EXPECT_EQ(report.status->control, ControlMode::kStandby);
  EXPECT_EQ(report.other.frames, 0u);
  const std::vector<Finding> findings = Diagnose(report);
  EXPECT_FALSE(HasError(findings)) << Said(report);
  ASSERT_EQ(findings.size(), 1u);  // as delivered
  EXPECT_THAT(findings[0].text, HasSubstr("off on J1, J2, J3, J4, J5, J6 (level 0, as delivered)"));
}

TEST(ArmMonitor, AsksAndNeverCommands) {
  MonitoredArm world;
  world.Watch(30);
  EXPECT_GT(world.sent.size(), 60u);  // it goes on asking, slowly ...
  EXPECT_LT(world.sent.size(), 90u);
  std::set<std::pair<int, std::array<uint8_t, 8>>> kinds;
  for (const CanFrame& frame : world.sent) {
    EXPECT_TRUE(frame.id == 0x4AF || frame.id == 0x472 || frame.id == 0x477) << frame.id;
    EXPECT_TRUE(IsFirmwareQuery(frame) || DecodeLimitQuery(frame) || DecodeParameterQuery(frame));
    kinds.insert({frame.id, frame.data});
  }
  EXPECT_EQ(kinds.size(), 15u);  // ... all of them
  EXPECT_FALSE(world.emulator->firmware().enabled(0));
}

TEST(ArmMonitor, SendsNothingWhenItIsToldTo) {
  MonitoredArm world({}, true);
  const ArmReport report = world.Report(5);
  EXPECT_THAT(world.sent, IsEmpty());
  EXPECT_TRUE(world.monitor->asked_all());
  EXPECT_FALSE(report.firmware.has_value());
  EXPECT_EQ(report.questions.asked, 0u);
  EXPECT_THAT(Said(report), IsEmpty());  // what was not asked is not missing
  EXPECT_THAT(ReportPage(report, {}), HasSubstr("none asked (--silent)"));
}

// Asks what a monitor asks, as fast as answers come, and all the time.
TEST(ArmMonitor, QuestionsOfAnotherProgramDisturbNoClient) {
  MonitoredArm world;
  const auto ask = [&](double seconds) {
    for (int i = 0; i < 100 * seconds; ++i) {
      (void)world.third->Send(Encode(LimitQuery{i % 6 + 1, i % 2 == 0}));
      (void)world.third->Send(EncodeFirmwareQuery());
      (void)world.third->Send(EncodeParameterQuery(kCollisionLevelQuery));
      world.Watch(0.01);
    }
  };
  ask(0.1);
  const absl::Status connected = world.arm->Connect();
  ASSERT_TRUE(connected.ok()) << connected;
  ask(0.5);
  ASSERT_TRUE(Enabled(world));
  for (int tick = 0; tick < 60; ++tick) {
    ASSERT_TRUE(world.arm->Send(Command({0.2, 0.2, -0.2, 0, 0, 0})).ok());
    ask(1.0 / 30);
    ASSERT_EQ(world.arm->Latest().faults, 0u) << ArmFaultNames(world.arm->Latest().faults);
  }
  EXPECT_NEAR(world.arm->Latest().position[0], 0.2, 0.01);
}

TEST(ArmMonitor, ConnectSucceedsBesideAMonitorAtAnyMoment) {
  for (int delay_ms = 0; delay_ms < 20; ++delay_ms) {
    MonitoredArm world;
    world.Watch(0.001 * delay_ms);
    // The monitor goes on asking while the client asks: whoever sleeps lets it poll.
    std::unique_ptr<PiperArm> second = std::make_unique<PiperArm>(world.bus.Attach(), world.time);
    const absl::Status status = second->Connect();
    EXPECT_TRUE(status.ok()) << delay_ms << ": " << status;
    EXPECT_EQ(second->firmware(), (Firmware{1, 8, 9}));
  }
}

TEST(ArmMonitor, SaysWhoCommandsAndAsksNothingMeanwhile) {
  MonitoredArm world;
  ASSERT_TRUE(world.arm->Connect().ok());
  world.Watch(1);
  ASSERT_TRUE(Enabled(world));
  world.monitor->Poll();
  world.sent.clear();
  (void)world.monitor->TakeReport();
  for (int tick = 0; tick < 60; ++tick) {
    ASSERT_TRUE(world.arm->Send(Command({0.1, 0.2, -0.2, 0, 0, 0})).ok());
    world.Watch(1.0 / 30);
  }
  const ArmReport report = world.monitor->TakeReport();
  EXPECT_THAT(world.sent, IsEmpty());
  EXPECT_TRUE(report.other.commands_now);
  EXPECT_NEAR(report.other.targets_per_second, 30, 1);
  EXPECT_TRUE(report.questions.waits);
  ASSERT_TRUE(report.joints[0].target.has_value());
  EXPECT_NEAR(*report.joints[0].target, 0.1, 1e-4);
  EXPECT_THAT(ReportPage(report, Diagnose(report)),
              AllOf(HasSubstr("as robot_client does"), HasSubstr("0x155"), HasSubstr("5.73"),
                    HasSubstr("another program or a leader arm commands this arm")));
  EXPECT_FALSE(HasError(Diagnose(report))) << Said(report);
  // A second of quiet later it asks again.
  world.Watch(2);
  EXPECT_THAT(world.sent, Not(IsEmpty()));
  EXPECT_EQ(world.arm->Latest().faults, 0u);
}

TEST(ArmMonitor, ReportsTorqueOfOldFirmwareInItsOwnScale) {
  EmulatorOptions old;
  old.version = {1, 8, 2};
  MonitoredArm world(old);
  ASSERT_TRUE(world.arm->Connect().ok());
  ASSERT_TRUE(Enabled(world));
  ASSERT_TRUE(world.Stream(Command({0.4, 0.9, -0.7, 0.2, 0.3, -0.5}), 3).ok());
  world.monitor->Poll();
  const ArmReport report = world.Report(1.5);
  EXPECT_NEAR(report.joints[1].torque, world.emulator->plant().reading().gravity[1], 0.8);
}

// What PiperArm refuses, and what else a person must be told.
struct Trouble {
  const char* name;
  std::function<void(EmulatorOptions&)> build;
  std::function<void(MonitoredArm&)> act;
  const char* said;
};

class ArmMonitorTrouble : public ::testing::TestWithParam<Trouble> {};

TEST_P(ArmMonitorTrouble, IsNamedWithAJointAndARemedy) {
  EmulatorOptions options;
  if (GetParam().build) GetParam().build(options);
  MonitoredArm world(options);
  world.Watch(0.5);
  if (GetParam().act) GetParam().act(world);
  world.Watch(4);
  (void)world.monitor->TakeReport();
  const ArmReport report = world.Report(1);
  EXPECT_TRUE(HasError(Diagnose(report)));
  EXPECT_THAT(Said(report), HasSubstr(std::string("WRONG ") + GetParam().said));
  // Both forms of output take it.
  EXPECT_THAT(ReportPage(report, Diagnose(report)),
              AllOf(HasSubstr("WRONG"), Not(HasSubstr("well:"))));
  EXPECT_FALSE(nlohmann::json::parse(ReportJson(report, Diagnose(report)))["well"].get<bool>());
}

CanFrame Raw(uint16_t id, std::array<uint8_t, 8> data) {
  CanFrame frame;
  frame.id = id;
  frame.data = data;
  return frame;
}

Trouble Fault(const char* name, FaultKind kind, int joint, const char* said) {
  return {name, [=](EmulatorOptions& o) { o.faults.push_back({kind, 0.3, joint, 0}); }, {}, said};
}

INSTANTIATE_TEST_SUITE_P(
    All, ArmMonitorTrouble,
    ::testing::Values(
        Trouble{"damaged_limits",
                {},
                [](MonitoredArm& w) {
                  w.emulator->firmware().SetLimit({1, -0.0017, -0.0017, 3.0});
                },
                "joint 2 answers upper = "},
        Trouble{"fast_limit",
                {},
                [](MonitoredArm& w) {
                  w.emulator->firmware().SetLimit({4, -1.2, 1.2, 30.0});
                },
                "joint 5 answers max_speed = 30.0000 rad/s"},
        Trouble{"old_firmware",
                [](EmulatorOptions& o) {
                  o.version = {1, 5, 1};
                },
                {},
                "firmware S-V1.5-1 is older than S-V1.5-2"},
        Trouble{"no_gripper_range",
                [](EmulatorOptions& o) { o.gripper_range = 0; },
                {},
                "the gripper's range is not configured"},
        Trouble{"leader",
                {},
                [](MonitoredArm& w) {
                  (void)w.third->Send(Raw(0x470, {0xFA, 0, 0, 0, 0, 0, 0, 0}));
                },
                "the arm is in leader mode"},
        Trouble{"some_without_power",
                {},
                [](MonitoredArm& w) {
                  for (int motor = 1; motor <= 5; ++motor)
                    (void)w.third->Send(Encode(MotorPower{motor, true}));
                },
                "only some joints have power; without it: J6"},
        Fault("teach", FaultKind::kTeach, 0, "the arm is being taught"),
        Fault("unknown_status", FaultKind::kStatusUnknown, 0,
              "the arm reports a status that is not known"),
        Fault("no_status", FaultKind::kStatusSilent, 0, "the arm's status (0x2A1) does not come"),
        Fault("collision", FaultKind::kCollision, 1,
              "status: collision protection has stopped the arm"),
        Fault("emergency_stop", FaultKind::kEmergencyStop, 0, "status: emergency stop"),
        Fault("hot_motor", FaultKind::kMotorHot, 2, "J3's driver reports: motor too hot"),
        Fault("under_voltage", FaultKind::kUnderVoltage, 3, "J4's driver reports: under-voltage"),
        Fault("torn", FaultKind::kTear, 2, "519 of 1099 joint samples were torn"),
        Fault("silent_joint", FaultKind::kJointSilent, 4,
              "J5 does not answer the arm's controller"),
        Fault("silent", FaultKind::kSilent, 0,
              "no complete joint sample comes: they have stopped")),
    [](const auto& info) { return std::string(info.param.name); });

TEST(ArmMonitor, NamesWhatNoEmulatedArmHas) {
  MonitoredArm world{EmulatorOptions()};
  const ArmReport well = world.Report(1);
  ASSERT_FALSE(HasError(Diagnose(well))) << Said(well);
  ArmReport report = well;
  report.joints[3].driver->supply_V -= 4;
  EXPECT_THAT(Said(report), HasSubstr("WRONG J4 has 20.0 V where the others have 24.0 V"));
  report = well;
  report.age.p99_s = report.age.worst_s = 0.06;
  EXPECT_THAT(Said(report), HasSubstr("WRONG the newest joint sample is often old (99 %: 60 ms)"));
  report.age.p99_s = 0.04;
  EXPECT_FALSE(HasError(Diagnose(report)));
  EXPECT_THAT(Said(report), HasSubstr("once no joint sample came for 60 ms"));
}

TEST(ArmMonitor, SaysWhatSilenceMayMean) {
  EmulatedTime time;
  InProcessBus bus(time);
  ArmMonitor monitor(bus.Attach(), time);
  ASSERT_TRUE(monitor.Open().ok());
  for (int i = 0; i < 2000; ++i) {
    time.SleepUntil(time.now_ns() + 5'000'000);
    monitor.Poll();
  }
  EXPECT_TRUE(monitor.asked_all());
  EXPECT_FALSE(monitor.heard());
  const ArmReport report = monitor.TakeReport();
  EXPECT_THAT(Said(report), AllOf(HasSubstr("nothing comes from an arm"), HasSubstr("1 Mbit/s")));
  EXPECT_EQ(Diagnose(report).size(), 1u);
}

TEST(ArmMonitor, WritesJsonWithEveryKeyWhateverIsKnown) {
  EmulatedTime time;
  InProcessBus bus(time);
  ArmMonitor nothing(bus.Attach(), time);
  ASSERT_TRUE(nothing.Open().ok());
  const ArmReport empty = nothing.TakeReport();
  MonitoredArm world;
  const ArmReport full = world.Report(1.2);
  const nlohmann::json a = nlohmann::json::parse(ReportJson(empty, Diagnose(empty)));
  const nlohmann::json b = nlohmann::json::parse(ReportJson(full, Diagnose(full)));
  EXPECT_EQ(b["schema"], "robostress.arm_report.v1");
  std::set<std::string> keys_a, keys_b, joint_a, joint_b;
  for (const auto& [key, value] : a.items()) keys_a.insert(key);
  for (const auto& [key, value] : b.items()) keys_b.insert(key);
  for (const auto& [key, value] : a["joints"][0].items()) joint_a.insert(key);
  for (const auto& [key, value] : b["joints"][0].items()) joint_b.insert(key);
  EXPECT_EQ(keys_a, keys_b);
  EXPECT_EQ(joint_a, joint_b);
  EXPECT_EQ(a["joints"].size(), 6u);
  EXPECT_TRUE(a["joints"][0]["angle_rad"].is_null());
  EXPECT_TRUE(a["firmware"].is_null());
  EXPECT_EQ(b["firmware"], "S-V1.8-9");
  EXPECT_NEAR(b["joints"][3]["supply_V"].get<double>(), 24, 0.5);
  EXPECT_EQ(b["joints"][3]["enabled"], false);
  EXPECT_NEAR(b["samples_per_second"].get<double>(), 200, 3);
  EXPECT_TRUE(b["well"].get<bool>());
  EXPECT_EQ(b["warnings"].size(), 1u);
  EXPECT_EQ(b["frames"].size(), 20u);
}

TEST(ArmMonitor, PagesFitATerminal) {
  MonitoredArm world;
  const ArmReport report = world.Report(1.2);
  const std::string page = ReportPage(report, {});
  size_t lines = 0;
  for (size_t start = 0, end; (end = page.find('\n', start)) != std::string::npos;
       start = end + 1, ++lines)
    EXPECT_LE(end - start, 130u) << page.substr(start, end - start);
  EXPECT_LE(lines, 45u);
  EXPECT_THAT(page, AllOf(HasSubstr("firmware S-V1.8-9"), HasSubstr("well: nothing is wrong"),
                          HasSubstr("J6 "), HasSubstr("angles  0x2A5 200 200 200 (200)")));
  EXPECT_THAT(ReportLine(report, {}), HasSubstr("power 0 of 6  normal"));
}

}  // namespace
}  // namespace robostress::piper
