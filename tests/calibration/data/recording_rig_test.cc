#include "calibration/data/recording_rig.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>

#include "absl/strings/str_cat.h"
#include "absl/strings/str_replace.h"
#include "calibration/data/measured_log.h"
#include "calibration/data/recording_text.h"
#include "common/atomic_file.h"
#include "common/csv_table.h"
#include "common/joint_errors/bam_parameters.h"
#include "common/recordings/joint_messages.h"
#include "common/recordings/recording.h"
#include "tests/calibration/data/recorded_joints.h"

namespace robostress::calibration {
namespace {

namespace fs = std::filesystem;
using namespace recorded_test;  // NOLINT(google-build-using-namespace)
using ::testing::AllOf;
using ::testing::Contains;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;

TEST(RecordingRigTest, WritesPositionsToTheBitAtTheirStampsBesideTheCommandThatHeld) {
  const Result result = Inspect(Following("following", 4000));
  ASSERT_EQ(result.plan.joints.size(), 2) << "what stands still is left out";
  EXPECT_EQ(result.plan.rate_hz, 100);
  EXPECT_EQ(result.summary.logs, 2);
  const std::vector<double> t = Column(result, "t"), lift = Column(result, "q_lift"),
                            turn = Column(result, "q_turn"),
                            commanded = Column(result, "q_cmd_lift");
  ASSERT_GT(t.size(), 1900);
  for (size_t i = 0; i < t.size(); ++i) {
    EXPECT_NEAR(t[i], 0.01 * static_cast<double>(i), 1e-9) << "stamps, not the recorder's times";
    EXPECT_EQ(lift[i], Angle(static_cast<int>(i), 1));
    EXPECT_EQ(turn[i], Angle(static_cast<int>(i), 0));
    EXPECT_EQ(commanded[i], Angle(static_cast<int>(i) + 3, 1));
  }
}

// The recorder writes a command 20 ms before its time or 30 ms behind it.
TEST(RecordingRigTest, PutsStampedCommandsAtTheirTimesWhateverTheRecordersOrder) {
  for (const int64_t late : {-2 * kTick, 3 * kTick}) {
    Recorder recorder;
    for (int i = 0; i < 3000; ++i) {
      const int64_t t = kStart + i * kTick;
      if (late > 0 && i >= 3) recorder.Reference(t, t - late, "a", Angle(i - 3, 0.1));
      recorder.JointState(t, {t, {"a"}, {Angle(i, 0)}});
      if (late < 0) recorder.Reference(t, t - late, "a", Angle(i + 2, 0.1));
    }
    const Result result = Inspect(recorder.Write("stamped_commands"));
    ASSERT_EQ(result.plan.joints.size(), 1);
    const std::vector<double> q = Column(result, "q_a"), command = Column(result, "q_cmd_a");
    ASSERT_GT(q.size(), 1900);
    const int before = late < 0 ? 2 : 0;  // rows before the first command
    for (size_t i = 0; i < q.size(); ++i) {
      EXPECT_EQ(q[i], Angle(static_cast<int>(i) + before, 0));
      EXPECT_EQ(command[i], Angle(static_cast<int>(i) + before, 0.1));
    }
  }
}

TEST(RecordingRigTest, PrefersRowsInWhichCommandsStandBesidePositions) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.JointState(t, {t, {"a"}, {Angle(i, 0)}});
    if (i > 20) recorder.Reference(t + 5, t + 5, "a", Angle(i, 0.1), {Angle(i, 0.01)});
  }
  const Result result = Inspect(recorder.Write("beside"));
  ASSERT_EQ(result.plan.joints.size(), 1);
  EXPECT_TRUE(result.plan.joints[0].command_in_row);
  EXPECT_EQ(Column(result, "q_a")[0], Angle(21, 0.01));
  EXPECT_EQ(Column(result, "q_cmd_a")[0], Angle(21, 0.1));
}

// The leader's arm reports its joints as well, twice as often, and what it reports is commanded.
TEST(RecordingRigTest, TakesTheArmThatIsCommandedAndNotTheOneThatLeads) {
  for (const int often : {1, 2}) {
    Recorder recorder;
    for (int i = 0; i < 3000; ++i) {
      const int64_t t = kStart + i * kTick;
      for (int k = 0; k < often; ++k)
        recorder.Other(t + k * kTick / 2, {t + k * kTick / 2, {"a"}, {Angle(i, 0.1)}});
      recorder.Command(t + 1, {Angle(i, 0.1)});
      recorder.JointState(t + 2, {t + 2, {"a"}, {Angle(i, 0)}});
    }
    const std::string recording = recorder.Write("teleoperation");
    const Result result = Inspect(recording);
    EXPECT_THAT(result.text,
                HasSubstr("Positions: /joint_states, because what /leader/joints holds "
                          "is what is commanded."));
    EXPECT_THAT(result.text,
                HasSubstr("/leader/joints holds the same joints; --topic /leader/joints takes"));
    ASSERT_EQ(result.plan.joints.size(), 1);
    EXPECT_EQ(Column(result, "q_a")[7], Angle(7, 0));
    EXPECT_EQ(Column(result, "q_cmd_a")[7], Angle(7, 0.1));
    RecordingOptions options;
    options.topic = "/leader/joints";
    EXPECT_THAT(Inspect(recording, options).text, HasSubstr("Positions: /leader/joints.\n"));
    options.topic = "/commands";
    RecordingStatistics statistics;
    EXPECT_THAT(std::string(Plan(recording, options, &statistics).status().message()),
                HasSubstr("--topic: '/commands' holds no positions of joints; those that do: "));
  }
}

TEST(RecordingRigTest, TakesJointStatesForCommandsWhereTheTopicSaysSo) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.Other(t, {t, {"a"}, {Angle(i, 0.1)}});
    recorder.JointState(t + 1, {t + 1, {"a"}, {Angle(i, 0)}});
  }
  const Result result = Inspect(recorder.Write("named_commands", "/arm/joint_command"), {});
  ASSERT_EQ(result.plan.joints.size(), 1);
  EXPECT_EQ(Column(result, "q_a")[7], Angle(7, 0));
  EXPECT_EQ(Column(result, "q_cmd_a")[7], Angle(7, 0.1));
}

// LeRobot's actions may be steps of the position, under the joint's name.
TEST(RecordingRigTest, TakesNoCommandOfTheNameThatIsFarFromTheJoint) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.Other(t, {t, {"a"}, {Angle(i + 1, 0) - Angle(i, 0)}});
    recorder.JointState(t + 1, {t + 1, {"a"}, {Angle(i, 0)}});
  }
  const Result result = Inspect(recorder.Write("steps", "/arm/joint_command"), {});
  EXPECT_THAT(result.plan.joints, IsEmpty());
  EXPECT_THAT(result.text,
              AllOf(HasSubstr("the command of a in /arm/joint_command stays 0.56"),
                    HasSubstr("from a joint that spans 1.6: a step, another unit, or another "
                              "joint's? It is not taken")));
  EXPECT_THAT(result.plan.why_none, HasSubstr("or stay far from them"));
}

TEST(RecordingRigTest, AsksForTheUnitOfTimesThatAreFarApart) {
  const auto table = [](double factor, int every) {
    std::string text = "t,q_a,dq_a,q_cmd_a\n";
    for (int i = 0; i < 2000; i += every)
      absl::StrAppend(&text, 1e-3 * factor * i, ",", Angle(i, 0), ",", 16 * std::cos(0.02 * i), ",",
                      Angle(i, 0.1), "\n");
    const std::string path = testing::TempDir() + "/times.csv";
    EXPECT_TRUE(WriteFileAtomically(path, text).ok());
    return path;
  };
  EXPECT_THAT(Inspect(table(1e3, 1)).text,
              AllOf(HasSubstr("rows are 1 s apart: are times in milliseconds? multiply t by 0.001"),
                    HasSubstr("a: velocity is 1000 times the position's derivative: is t in "
                              "milliseconds? multiply t by 0.001")));
  EXPECT_THAT(Inspect(table(1e3, 10)).plan.why_none,
              HasSubstr("rows come at 0.1 Hz, a log has 1 to 100000; are times in milliseconds? "
                        "multiply t by 0.001"));
  EXPECT_THAT(Inspect(table(1, 1)).text, Not(HasSubstr("milliseconds?")));
}

TEST(RecordingRigTest, TellsWhichCommandIsOfWhichJointByNearness) {
  const Result result = Inspect(Following("nearness", 3000));
  ASSERT_EQ(result.plan.joints.size(), 2);
  const auto& signals = result.statistics.signals();
  EXPECT_EQ(signals[result.plan.joints[0].command].description.joint, "[1]");
  EXPECT_EQ(signals[result.plan.joints[1].command].description.joint, "[0]");
  EXPECT_THAT(result.text, HasSubstr("Command of lift: /commands [1], because it names no joint"));
}

TEST(RecordingRigTest, MarksWhatTheRecordingDoesNotSayAndTheRigsReaderNamesIt) {
  const Result result = Inspect(Following("marks", 3000));
  EXPECT_THAT(result.summary.to_fill_in, ElementsAre("model", "lift.servo.kp", "lift.servo.kd",
                                                     "turn.servo.kp", "turn.servo.kd"));
  const auto rig = ReadRig(result.summary.rig_file);
  ASSERT_FALSE(rig.ok());
  EXPECT_THAT(std::string(rig.status().message()),
              HasSubstr("joints[0].servo.kp: is 'FILL_IN', must be a finite number"));
}

TEST(RecordingRigTest, NamesTheModelThatTheFirstRigIsGiven) {
  const std::string recording = Following("model", 3000), folder = recording + "_modelled";
  RecordingStatistics statistics;
  auto plan = Plan(recording, {}, &statistics);
  ASSERT_TRUE(plan.ok()) << plan.status();
  plan->model = testing::TempDir() + "/models/arm.urdf";
  fs::remove_all(folder);
  const auto summary = WriteRecordingRig(recording, *plan, std::nullopt, folder);
  ASSERT_TRUE(summary.ok()) << summary.status();
  EXPECT_THAT(summary->to_fill_in, Not(Contains("model")));
  const auto text = ReadFile(summary->rig_file);
  ASSERT_TRUE(text.ok()) << text.status();
  const std::string named = fs::path(plan->model)
                                .lexically_normal()
                                .lexically_relative(fs::path(folder).lexically_normal());
  EXPECT_THAT(*text, HasSubstr("model: " + named + "\n"));
}

TEST(RecordingRigTest, TakesOverADeclaredRigAndItsLogsPassTheGates) {
  Rig declared;
  declared.file = testing::TempDir() + "/declared/rig.yaml";
  declared.name = "bench";
  declared.model = testing::TempDir() + "/declared/arm.xml";
  for (const char* name : {"turn", "other", "lift"}) {
    RigJoint joint;
    joint.name = name;
    joint.servo.kp = 50;
    joint.fit = {"damping"};
    declared.joints.push_back(joint);
  }
  const Result result = Inspect(Following("declared", 3000), {}, declared);
  EXPECT_THAT(result.summary.to_fill_in, IsEmpty());
  const auto rig = ReadRig(result.summary.rig_file);
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_EQ(fs::path(rig->model).lexically_normal(), fs::path(declared.model).lexically_normal());
  ASSERT_EQ(rig->joints.size(), 2);
  EXPECT_EQ(rig->joints[0].name, "lift");
  EXPECT_EQ(rig->joints[0].servo.kp, 50);
  for (const RigLog& log : rig->logs) {
    const auto measured = ReadMeasuredLog(*rig, log);
    ASSERT_TRUE(measured.ok()) << measured.status();
    EXPECT_EQ(measured->clock_jitter, 0);
  }
  declared.joints.pop_back();
  RecordingStatistics statistics;
  const std::string recording = Following("declared", 3000);
  const auto plan = Plan(recording, {}, &statistics);
  ASSERT_TRUE(plan.ok());
  const auto refused = WriteRecordingRig(recording, *plan, declared, result.folder);
  EXPECT_THAT(std::string(refused.status().message()), HasSubstr("--rig: has no joint 'lift'"));
  const auto again = WriteRecordingRig(recording, *plan, std::nullopt, result.folder);
  EXPECT_THAT(std::string(again.status().message()), HasSubstr("holds files already"));
}

// Names change their order, a joint appears later, a third publisher names others.
TEST(RecordingRigTest, FollowsNamesAndNotPlaces) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.Command(t, {Angle(i, 0), Angle(i, 1)});
    if (i % 2 == 0)
      recorder.JointState(t, {t, {"a", "b"}, {Angle(i, 0), Angle(i, 1)}});
    else
      recorder.JointState(t, {t, {"b", "a"}, {Angle(i, 1), Angle(i, 0)}});
    if (i > 2000) recorder.JointState(t + 100, {t + 100, {"gripper"}, {Angle(i, 2)}});
  }
  const Result result = Inspect(recorder.Write("names"));
  ASSERT_EQ(result.plan.joints.size(), 2);
  const std::vector<double> a = Column(result, "q_a"), b = Column(result, "q_b");
  for (size_t i = 0; i < a.size(); ++i) {
    EXPECT_EQ(a[i], Angle(static_cast<int>(i), 0));
    EXPECT_EQ(b[i], Angle(static_cast<int>(i), 1));
  }
  EXPECT_EQ(result.summary.bad_rows, 0);
  EXPECT_THAT(result.text, HasSubstr("its messages hold 2 different sets of joints"));
}

TEST(RecordingRigTest, SplitsAtGapsAndLeavesOutRowsThatAreNoneOrOutOfOrder) {
  Recorder recorder;
  int64_t t = kStart;
  for (int i = 0; i < 3000; ++i) {
    t += i == 1500 ? 100 * kTick : kTick;
    recorder.Command(t, {Angle(i, 0)});
    const double q = i == 700 ? std::nan("") : Angle(i, 0);
    recorder.JointState(t, {t, {"a"}, {q}});
    if (i == 800) recorder.JointState(t, {t, {"a"}, {q}});                        // again
    if (i == 900) recorder.JointState(t, {t - 2'000'000'000, {"a"}, {q + 100}});  // far back
    if (i == 1000) recorder.JointState(t, {t + 1, {"a"}, {INFINITY}});
  }
  const Result result = Inspect(recorder.Write("faults"));
  ASSERT_EQ(result.summary.logs, 2);
  EXPECT_EQ(result.summary.wrong_stamps, 1);
  EXPECT_EQ(result.summary.bad_rows, 2);
  EXPECT_EQ(result.summary.late_rows, 1);
  EXPECT_EQ(Column(result, "q_a", 0).size(), 1499);
  EXPECT_EQ(Column(result, "q_a", 1).size(), 1500);
  for (int log = 0; log < 2; ++log) {
    for (const double q : Column(result, "q_a", log)) EXPECT_LT(std::abs(q), 1);
  }
  EXPECT_THAT(result.text, HasSubstr("1 gaps over 5 rows"));
  EXPECT_THAT(result.text, HasSubstr("1 times backwards"));
  EXPECT_THAT(result.text, HasSubstr("1 times the same again"));
  EXPECT_THAT(result.text, HasSubstr("2 of 3003 are no numbers"));
}

TEST(RecordingRigTest, TakesTheRecordersTimesWhereStampsStandStill) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i)
    recorder.JointState(kStart + i * kTick, {kStart, {"a"}, {Angle(i, 0)}, {}, {Angle(i, 2)}});
  const Result result = Inspect(recorder.Write("still_stamps"));
  EXPECT_EQ(result.plan.rate_hz, 100);
  EXPECT_EQ(Column(result, "q_a")[50], Angle(50, 0));
  EXPECT_THAT(result.text, HasSubstr("rows stand at the recorder's times"));
}

TEST(RecordingRigTest, WritesNoRigWithoutWhatDrivesTheJoints) {
  Recorder recorder;
  for (int i = 0; i < 1000; ++i)
    recorder.JointState(kStart + i * kTick, {kStart + i * kTick, {"a"}, {Angle(i, 0)}});
  const Result result = Inspect(recorder.Write("positions_only"));
  EXPECT_THAT(result.plan.joints, IsEmpty());
  EXPECT_THAT(result.plan.why_none, HasSubstr("neither the commands nor the torques"));
}

TEST(RecordingRigTest, TakesEffortWhereThereIsNoCommand) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.JointState(t, {t, {"a"}, {Angle(i, 0)}, {}, {Angle(i, 2)}});
  }
  const Result result = Inspect(recorder.Write("effort"));
  EXPECT_EQ(result.plan.joints.at(0).input, JointInput::kTorque);
  EXPECT_EQ(Column(result, "tau_a")[7], Angle(7, 2));
  EXPECT_THAT(result.text, HasSubstr("effort is what the driver puts there"));
}

TEST(RecordingRigTest, DoubtsAnglesInDegreesAndVelocitiesInThem) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    const double degrees = 180 / M_PI;
    recorder.JointState(t, {t,
                            {"a", "b"},
                            {Angle(i, 0) * degrees, Angle(i, 1)},
                            {0, 0.8 * 2 * std::cos(0.02 * i + 1) * degrees},
                            {1, 2.0 * i}});
  }
  const std::string recording = recorder.Write("degrees");
  EXPECT_THAT(Inspect(recording).text, HasSubstr("a: values reach 45.84: degrees?"));
  EXPECT_THAT(Inspect(recording).text, HasSubstr("b: the velocity's numbers are degrees"));
  RecordingOptions options;
  options.to_rad = M_PI / 180;
  options.joints = {"b"};
  RecordingStatistics statistics;
  const auto plan = Plan(recording, options, &statistics);
  ASSERT_TRUE(plan.ok());
  EXPECT_NEAR(plan->joints.at(0).to_rad, 0.0174533, 1e-6);
}

// An effort on the topic of a single joint is near nothing.
TEST(RecordingRigTest, TakesNoArrayForCommandsThatIsNotNearTheJoint) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.Command(t, {Angle(i, 1.6)});
    recorder.JointState(t, {t, {"a"}, {Angle(i, 0)}});
  }
  const Result result = Inspect(recorder.Write("not_near"));
  EXPECT_THAT(result.plan.joints, IsEmpty());
}

TEST(RecordingRigTest, SaysThatCommandsAreFewerThanPositions) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    if (i % 10 == 0) recorder.Command(t, {Angle(i, 0)});
    recorder.JointState(t, {t, {"a"}, {Angle(i, 0)}});
  }
  EXPECT_THAT(Inspect(recorder.Write("slow_commands")).text,
              HasSubstr("Commands come at 10 Hz, positions at 100 Hz: between, the last is held"));
}

TEST(RecordingRigTest, NamesAJointThatIsNotThere) {
  RecordingStatistics statistics;
  RecordingOptions options;
  options.joints = {"elbow"};
  const auto plan = Plan(Following("choice", 200), options, &statistics);
  options.joints = {"lift", "lift"};
  RecordingStatistics again;
  EXPECT_THAT(std::string(Plan(Following("choice", 200), options, &again).status().message()),
              HasSubstr("--joints: 'lift' stands twice"));
  EXPECT_THAT(std::string(plan.status().message()),
              HasSubstr("--joints: 'elbow' is not in /joint_states; there are: lift, turn, still"));
}

TEST(RecordingRigTest, PrintsNoControlCharactersAndTakesNoNameThatBreaksATable) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.Command(t, {Angle(i, 0)});
    recorder.JointState(t, {t, {"a", "b,\x1b[31m\n", ""}, {Angle(i, 0), Angle(i, 1), Angle(i, 2)}});
  }
  const Result result = Inspect(recorder.Write("odd_names"));
  ASSERT_EQ(result.plan.joints.size(), 1);
  EXPECT_EQ(result.plan.joints[0].name, "a");
  EXPECT_THAT(result.text, Not(HasSubstr("\x1b")));
  EXPECT_THAT(result.text, HasSubstr("its name cannot stand in a table"));
}

// What `robostress scenarios --from-bam` prints, with what it leaves to the reader filled in.
TEST(RecordingRigTest, TheServoPartOfBamIsAJointOfARig) {
  BamParameters servo;
  servo.kt = 1.5, servo.R = 2.5, servo.armature = 0.011;
  servo.friction_base = 0.04, servo.friction_viscous = 0.07, servo.load_friction_motor = 0.12;
  const std::string folder = testing::TempDir() + "/bam_rig";
  fs::create_directories(folder);
  const std::string file = folder + "/rig.yaml";
  ASSERT_TRUE(
      WriteFileAtomically(file, absl::StrCat("name: servo\nmodel: arm.xml\nrate_hz: 200\njoints:\n",
                                             absl::StrReplaceAll(RigJointOfBam(servo, "hinge"),
                                                                 {{"FILL_IN", "7.4"}}),
                                             "logs: [{file: log.csv, role: fit}]\n"))
          .ok());
  const auto rig = ReadRig(file);
  ASSERT_TRUE(rig.ok()) << rig.status();
  ASSERT_EQ(rig->joints.size(), 1);
  const RigJoint& joint = rig->joints[0];
  EXPECT_EQ(joint.servo.type, Servo::Type::kDcMotor);
  EXPECT_EQ(joint.servo.kt, 1.5);
  EXPECT_EQ(joint.servo.R, 2.5);
  EXPECT_EQ(joint.parameters.at("armature"), 0.011);
  ASSERT_EQ(joint.effects.size(), 2);
  EXPECT_EQ(joint.effects[0].parameters.at("Fs"), 0.04);
  EXPECT_EQ(joint.effects[1].parameters.at("mu"), 0.12);
}

}  // namespace
}  // namespace robostress::calibration
