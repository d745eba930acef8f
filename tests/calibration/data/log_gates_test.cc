#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <functional>

#include "absl/strings/str_cat.h"
#include "calibration/data/local_polynomial.h"
#include "calibration/data/measured_log.h"
#include "calibration/model/joint_model.h"
#include "calibration/model/plant.h"
#include "common/atomic_file.h"
#include "common/random.h"

namespace robostress::calibration {
namespace {

using testing::AllOf;
using testing::HasSubstr;

constexpr double kDt = 0.005;
constexpr int kRows = 400;
constexpr double kNoise = 1e-4;  // [rad]

double Motion(double t) { return 0.5 * std::sin(2 * M_PI * t); }

// One row of a log that is in order; tests change what they are about.
struct Row {
  double t, command, q, tau;
};
using Change = std::function<void(int, Row&)>;

std::string LogText(const Change& change,
                    const std::string& header = "t,q_cmd_hinge,q_hinge,tau_hinge") {
  std::string text = header + "\n";
  RandomStream noise(StreamKey("log_gates"));
  for (int k = 0; k < kRows; ++k) {
    const double t = k * kDt;
    Row row{t, Motion(t), Motion(t - 0.01) + kNoise * noise.Normal(), std::cos(5 * t)};
    change(k, row);
    absl::StrAppend(&text, row.t, ",", row.command, ",", row.q, ",", row.tau, "\n");
  }
  return text;
}

class LogGates : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = testing::TempDir() + "/log_gates";
    ASSERT_TRUE(MakeDirectories(folder_).ok());
    rig_.file = folder_ + "/rig.yaml";
    rig_.rate_hz = 1 / kDt;
    RigJoint joint;
    joint.name = "hinge";
    joint.servo.kp = 10;
    rig_.joints = {joint};
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  absl::StatusOr<MeasuredLog> Read(const std::string& text) {
    RigLog log;
    log.file = folder_ + "/log.csv";
    EXPECT_TRUE(WriteFileAtomically(log.file, text).ok());
    return ReadMeasuredLog(rig_, log);
  }
  absl::StatusOr<MeasuredLog> Read(const Change& change) { return Read(LogText(change)); }
  std::string Refusal(const Change& change) {
    const auto log = Read(change);
    EXPECT_FALSE(log.ok());
    return std::string(log.status().message());
  }
  std::string Refusal(const std::string& text) {
    const auto log = Read(text);
    EXPECT_FALSE(log.ok());
    return std::string(log.status().message());
  }

  std::string folder_;
  Rig rig_;
};

TEST_F(LogGates, ReadsALogThatIsInOrderWithoutANote) {
  const auto log = Read([](int, Row&) {});
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_EQ(log->rows, kRows);
  EXPECT_NEAR(log->dt, kDt, 1e-9);
  EXPECT_THAT(log->notes, testing::IsEmpty());
  const JointRecord& record = log->joints[0];
  EXPECT_EQ(record.command.size(), static_cast<size_t>(kRows));
  EXPECT_NEAR(record.dq[200], M_PI * std::cos(2 * M_PI * (200 * kDt - 0.01)), 0.02);
  EXPECT_NEAR(record.noise, kNoise, 0.2 * kNoise);
}

TEST_F(LogGates, RefusesAColumnThatTheInputNeedsAndTheFileLacks) {
  EXPECT_THAT(Refusal(LogText([](int, Row&) {}, "t,q_cmd_hinge,q_other,tau_hinge")),
              AllOf(HasSubstr("log.csv"), HasSubstr("no column 'q_hinge'"), HasSubstr("q_other")));
  EXPECT_THAT(Refusal(LogText([](int, Row&) {}, "time,q_cmd_hinge,q_hinge,tau_hinge")),
              AllOf(HasSubstr("no column 't'"), HasSubstr("time")));
  rig_.joints[0].velocity = VelocitySide::kMotor;
  EXPECT_THAT(Refusal([](int, Row&) {}), HasSubstr("no column 'dq_hinge'"));
  rig_.joints[0].input = JointInput::kTransmission;
  EXPECT_THAT(Refusal([](int, Row&) {}), HasSubstr("no column 'q_motor_hinge'"));
}

TEST_F(LogGates, RefusesAColumnThatStandsTwice) {
  EXPECT_THAT(Refusal(LogText([](int, Row&) {}, "t,q_hinge,q_hinge,tau_hinge")),
              HasSubstr("'q_hinge' stands twice"));
}

TEST_F(LogGates, RefusesWhatIsNoFiniteNumberWithLineAndColumn) {
  EXPECT_THAT(Refusal([](int k, Row& row) {
                if (k == 17) row.q = NAN;
              }),
              AllOf(HasSubstr("log.csv:19: q_hinge"), HasSubstr("nan")));
  EXPECT_THAT(Refusal([](int k, Row& row) {
                if (k == 0) row.tau = INFINITY;
              }),
              AllOf(HasSubstr("log.csv:2: tau_hinge")));
  std::string words = LogText([](int, Row&) {});
  words.replace(words.find("\n0.005,") + 1, 5, "soon!");
  EXPECT_THAT(Refusal(words), AllOf(HasSubstr("log.csv:3"), HasSubstr("soon!")));
}

TEST_F(LogGates, RefusesARowThatIsTooShort) {
  EXPECT_THAT(Refusal(LogText([](int, Row&) {}) + "2.1,0.5\n"),
              AllOf(HasSubstr(absl::StrCat("log.csv:", kRows + 2)), HasSubstr("has 2 columns")));
}

TEST_F(LogGates, RefusesAFileThatIsEmptyShortOrAbsent) {
  EXPECT_THAT(Refusal(std::string()), HasSubstr("has no rows"));
  std::string text = LogText([](int, Row&) {});
  EXPECT_THAT(Refusal(text.substr(0, text.find("\n0.05,") + 1)), HasSubstr("has 10 rows"));
  RigLog log;
  log.file = folder_ + "/absent.csv";
  EXPECT_THAT(std::string(ReadMeasuredLog(rig_, log).status().message()), HasSubstr("absent.csv"));
}

TEST_F(LogGates, RefusesAClockThatStandsGoesBackOrLeavesAGap) {
  EXPECT_THAT(Refusal([](int k, Row& row) {
                if (k == 100) row.t = 99 * kDt;
              }),
              AllOf(HasSubstr("log.csv:102"), HasSubstr("must increase")));
  EXPECT_THAT(Refusal([](int k, Row& row) {
                if (k >= 100) row.t += 0.2;
              }),
              AllOf(HasSubstr("log.csv:102"), HasSubstr("a gap of 0.205 s"), HasSubstr("split")));
}

TEST_F(LogGates, NamesTimesOfAnEpochWithAllTheirDigits) {
  const std::string text = "t,q_cmd_hinge,q_hinge\n1700000000.01,0,0\n1700000000.005,0,0\n";
  std::string rows;
  for (int k = 0; k < 60; ++k) absl::StrAppend(&rows, "18", 10000000 + k, ",0,0\n");
  EXPECT_THAT(Refusal(text + rows),
              HasSubstr("t is 1700000000.005 after 1700000000.01; the clock"));
}

TEST_F(LogGates, RefusesAClockInMillisecondsOrOfAnotherRate) {
  EXPECT_THAT(Refusal([](int, Row& row) { row.t *= 1000; }),
              HasSubstr("the times are milliseconds: multiply them by 0.001"));
  EXPECT_THAT(Refusal([](int, Row& row) { row.t *= 1e6; }),
              HasSubstr("microseconds: multiply them by 1e-06"));
  EXPECT_THAT(Refusal([](int, Row& row) { row.t *= 1.1; }),
              AllOf(HasSubstr("rate_hz is 200"), HasSubstr("is t in seconds")));
}

TEST_F(LogGates, ResamplesAJitteryClockAndSaysSo) {
  const auto jitter = [](int k) { return 0.2 * kDt * std::sin(37.0 * k); };
  const auto log = Read([&](int k, Row& row) {
    row.t += jitter(k);
    row.command = Motion(row.t);
    row.q = Motion(row.t - 0.01);
  });
  ASSERT_TRUE(log.ok()) << log.status();
  ASSERT_EQ(log->notes.size(), 1u);
  EXPECT_THAT(log->notes[0], AllOf(HasSubstr("jitters"), HasSubstr("resampled")));
  EXPECT_NEAR(log->dt, kDt, 1e-12);
  for (int k = 20; k < log->rows; k += 50)
    EXPECT_NEAR(log->joints[0].q[k], Motion(jitter(0) + k * kDt - 0.01), 5e-4);
}

TEST_F(LogGates, TakesWholeTurnsOutOfAnAngle) {
  const auto log = Read([](int, Row& row) {
    row.q = std::remainder(row.q + 3, 2 * M_PI);
    row.command = std::remainder(row.command + 3, 2 * M_PI);
  });
  ASSERT_TRUE(log.ok()) << log.status();
  const JointRecord& record = log->joints[0];
  for (int k = 1; k < log->rows; ++k) {
    EXPECT_LT(std::abs(record.q[k] - record.q[k - 1]), 0.1);
    EXPECT_LT(std::abs(record.command[k] - record.command[k - 1]), 0.1);
    EXPECT_LT(std::abs(record.command[k] - record.q[k]), 0.2);
  }
  EXPECT_THAT(log->notes, testing::Contains(HasSubstr("whole turn")));
}

// A curve drawn through a jump would have values that no turn mends.
TEST_F(LogGates, TakesWholeTurnsOutBeforeRowsAreResampledOrFilledIn) {
  for (const bool lost : {false, true}) {
    const auto plain = [&](int k, Row& row) {
      row.t = (k + (lost && k >= 150 ? 2 : 0)) * kDt + 0.2 * kDt * std::sin(37.0 * k);
      row.command = 8 * Motion(row.t);
      row.q = 8 * Motion(row.t - 0.01);
    };
    const auto wrapped = [&](int k, Row& row) {
      plain(k, row);
      row.command = std::remainder(row.command, 2 * M_PI);
      row.q = std::remainder(row.q + 2, 2 * M_PI) - 2;
    };
    const auto expected = Read(plain), log = Read(wrapped);
    ASSERT_TRUE(expected.ok()) << expected.status();
    ASSERT_TRUE(log.ok()) << log.status();
    EXPECT_THAT(log->notes, testing::Contains(HasSubstr("whole turn")));
    for (int k = 0; k < log->rows; ++k) {
      EXPECT_NEAR(log->joints[0].q[k], expected->joints[0].q[k], 1e-4) << k;
      EXPECT_NEAR(log->joints[0].command[k], expected->joints[0].command[k], 1e-4) << k;
    }
  }
}

TEST_F(LogGates, RefusesDegreesBesideRadiansWithTheFactor) {
  EXPECT_THAT(Refusal([](int, Row& row) { row.command *= 180 / M_PI; }),
              HasSubstr("the numbers of q_cmd_hinge are degrees: multiply them by 0.0174533"));
  EXPECT_THAT(Refusal([](int, Row& row) { row.q *= 180 / M_PI; }),
              HasSubstr("the numbers of q_hinge are degrees: multiply them by 0.0174533"));
  EXPECT_THAT(Refusal([](int, Row& row) { row.q *= 30; }), HasSubstr("are both in radians"));
}

TEST_F(LogGates, RefusesCountsOfAnEncoderWithTheFactorWhereItIsKnown) {
  constexpr double kCounts = 4096 / (2 * M_PI);
  EXPECT_THAT(Refusal([](int, Row& row) { row.q = std::round(row.q * kCounts); }),
              AllOf(HasSubstr("q_hinge holds whole numbers"), HasSubstr("counts of an encoder"),
                    HasSubstr("0.00153"), HasSubstr("which q_cmd_hinge gives")));
  EXPECT_THAT(Refusal([](int, Row& row) {
                row.q = std::round(row.q * kCounts);
                row.command = std::round(row.command * kCounts);
              }),
              HasSubstr("2 pi / counts a turn, 0.00153398 at 4096"));
  // An encoder's steps are no counts once they are radians, and few whole numbers are none.
  EXPECT_TRUE(Read([](int, Row& row) { row.q = std::round(row.q * kCounts) / kCounts; }).ok());
  EXPECT_TRUE(Read([](int, Row& row) {
                row.command *= 40;
                row.q = std::round(row.command);
              }).ok());
}

TEST_F(LogGates, RefusesAMotorsVelocityInDegrees) {
  rig_.joints[0].velocity = VelocitySide::kMotor;
  const auto with_velocity = [](double unit) {
    std::string text = "t,q_cmd_hinge,q_hinge,dq_hinge\n";
    for (int k = 0; k < kRows; ++k) {
      const double t = k * kDt;
      absl::StrAppend(&text, t, ",", Motion(t), ",", Motion(t - 0.01), ",",
                      unit * M_PI * std::cos(2 * M_PI * (t - 0.01)), "\n");
    }
    return text;
  };
  EXPECT_TRUE(Read(with_velocity(1)).ok());
  EXPECT_TRUE(Read(with_velocity(1.3)).ok()) << "a transmission lies between";
  EXPECT_THAT(Refusal(with_velocity(180 / M_PI)),
              AllOf(HasSubstr("dq_hinge"), HasSubstr("degrees: multiply them by 0.0174533")));
}

TEST_F(LogGates, RefusesAConstantChannelAndAMotionWithinTheNoise) {
  EXPECT_THAT(Refusal([](int, Row& row) { row.q = 0.25; }),
              AllOf(HasSubstr("'hinge' is constant"), HasSubstr("0.25")));
  EXPECT_THAT(Refusal([](int, Row& row) {
                row.q -= Motion(row.t - 0.01) * 0.9999;
                row.command *= 1e-4;
              }),
              HasSubstr("too little excitation"));
  EXPECT_THAT(Refusal([](int, Row& row) { row.command = 0.1; }),
              AllOf(HasSubstr("q_cmd_hinge"), HasSubstr("constant")));
}

TEST_F(LogGates, CountsAnEncodersStepAsNoiseHoweverSlowTheMotion) {
  constexpr double kStep = 2e-3;
  const auto log = Read([](int, Row& row) {
    row.command = 0.1 * std::sin(0.5 * row.t);
    row.q = kStep * std::round(row.command / kStep);
  });
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_NEAR(log->joints[0].noise, kStep / std::sqrt(12.0), 1e-6);
}

TEST_F(LogGates, NotesATorqueThatStandsAtItsLimit) {
  const auto log = Read([](int, Row& row) { row.tau = std::clamp(2 * row.tau, -1.0, 1.0); });
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_THAT(log->notes, testing::Contains(HasSubstr("saturated")));
}

TEST_F(LogGates, ReadsWhereTheDriveIsOff) {
  rig_.joints[0].enable = "tau_hinge";
  const auto log = Read([](int k, Row& row) { row.tau = k < 200; });
  ASSERT_TRUE(log.ok()) << log.status();
  EXPECT_EQ(log->joints[0].enable[199], 1);
  EXPECT_EQ(log->joints[0].enable[200], 0);
  rig_.joints[0].enable = "torque_enable";
  EXPECT_THAT(Refusal([](int, Row&) {}), HasSubstr("no column 'torque_enable'"));
}

class RigGates : public testing::Test {
 protected:
  void SetUp() override {
    folder_ = testing::TempDir() + "/rig_gates";
    ASSERT_TRUE(MakeDirectories(folder_).ok());
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  absl::StatusOr<Rig> Read(const std::string& text) {
    EXPECT_TRUE(WriteFileAtomically(folder_ + "/rig.yaml", text).ok());
    return ReadRig(folder_ + "/rig.yaml");
  }
  static std::string Text(const std::string& joint, const std::string& log) {
    return absl::StrCat("name: a\nmodel: m.xml\nrate_hz: 200\njoints:\n  - {", joint,
                        "}\nlogs:\n  - {", log, "}\n");
  }
  static constexpr const char* kJoint = "name: hinge, input: position_target, servo: {kp: 10}";
  std::string folder_;
};

TEST_F(RigGates, WhatIsWrittenReadsBackTheSame) {
  const auto rig =
      Read(Text("name: hinge, input: position_target, servo: {kp: 10, kd: 1, torque_limit: 3, "
                "feedback: motor}, velocity: motor, "
                "enable: on_hinge, fit: [armature], effects: [{type: backlash, B: 0.01, fit: [B]}]",
                "file: log.csv, role: fit, condition: warm, overrides: {hinge.servo.kp: 20}"));
  ASSERT_TRUE(rig.ok()) << rig.status();
  const auto again = Read(WriteRig(*rig));
  ASSERT_TRUE(again.ok()) << again.status();
  EXPECT_EQ(WriteRig(*again), WriteRig(*rig));
  EXPECT_EQ(again->joints[0].enable, "on_hinge");
  EXPECT_EQ(again->joints[0].servo.torque_limit, 3);
  EXPECT_EQ(again->joints[0].velocity, VelocitySide::kMotor);
  EXPECT_EQ(again->joints[0].effects[0].parameters.at("B"), 0.01);
  EXPECT_EQ(again->logs[0].overrides.at("hinge.servo.kp"), 20);
}

TEST_F(RigGates, RefusesWhatItDoesNotKnowAndSaysWhatItDoes) {
  const auto message = [&](const std::string& joint, const std::string& log) {
    return std::string(Read(Text(joint, log)).status().message());
  };
  EXPECT_THAT(
      message("name: hinge, input: torques", "file: a.csv"),
      AllOf(HasSubstr("joints[0].input"), HasSubstr("'torques'"), HasSubstr("transmission")));
  EXPECT_THAT(message("name: hinge, input: torque, velocity: link", "file: a.csv"),
              AllOf(HasSubstr("joints[0].velocity"), HasSubstr("'link'"), HasSubstr("motor")));
  EXPECT_THAT(message("name: hinge, input: torque, fits: [armature]", "file: a.csv"),
              AllOf(HasSubstr("unknown key 'fits'"), HasSubstr("fit")));
  EXPECT_THAT(message("name: hinge, input: torque, fit: [weight]", "file: a.csv"),
              AllOf(HasSubstr("'weight'"), HasSubstr("mass_scale")));
  EXPECT_THAT(message("name: hinge, input: torque, effects: [{type: rust}]", "file: a.csv"),
              AllOf(HasSubstr("'rust'"), HasSubstr("stribeck_friction")));
  EXPECT_THAT(message("name: hinge, input: position_target", "file: a.csv"), HasSubstr("servo"));
  EXPECT_THAT(message(kJoint, "file: a.csv, role: test"), HasSubstr("held_out"));
  EXPECT_THAT(message(kJoint, "file: a.csv, role: held_out"), HasSubstr("no log has role fit"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {elbow.servo.kp: 3}"), HasSubstr("elbow"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {hinge.known_mass: -1}"),
              HasSubstr("hinge.known_mass: is -1, must be at least 0"));
  EXPECT_THAT(message("name: hinge, input: position_target, servo: {kp: .nan}", "file: a.csv"),
              HasSubstr("finite"));
  EXPECT_THAT(message("name: hinge, name: elbow, input: torque", "file: a.csv"),
              HasSubstr("joints[0]: key 'name' is given twice; remove one"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {hinge.damping: 1, hinge.damping: 2}"),
              HasSubstr("overrides: key 'hinge.damping' is given twice"));
  EXPECT_THAT(std::string(Read("name: a\n---\nname: b\n").status().message()),
              HasSubstr("a second document begins before line 3"));
  EXPECT_THAT(std::string(Read("name: [").status().message()), HasSubstr("not YAML"));
}

TEST_F(RigGates, RefusesKeysThatStandTwice) {
  const auto message = [&](const std::string& joint, const std::string& log) {
    return std::string(Read(Text(joint, log)).status().message());
  };
  EXPECT_THAT(
      message("name: hinge, input: position_target, servo: {kp: 20, kp: 2000}", "file: a.csv"),
      HasSubstr("joints[0].servo: key 'kp' is given twice; remove one"));
  EXPECT_THAT(message(kJoint, "file: a.csv, overrides: {hinge.damping: 1, hinge.damping: 2}"),
              HasSubstr("logs[0].overrides: key 'hinge.damping' is given twice"));
  EXPECT_THAT(message("name: hinge, input: torque, fit: [damping, damping]", "file: a.csv"),
              HasSubstr("joints[0].fit[1]: is 'damping' again; leave one"));
  const auto metrics =
      Read(Text(kJoint, "file: a.csv") + "metric: {unit: m}\nmetric: {unit: rad}\n");
  EXPECT_THAT(std::string(metrics.status().message()),
              HasSubstr("rig.yaml: key 'metric' is given twice"));
}

TEST_F(RigGates, RefusesValuesThatNoMachineHas) {
  const auto of_joint = [&](const std::string& text) {
    return std::string(Read(Text(absl::StrCat("name: hinge, input: torque, ", text), "file: a.csv"))
                           .status()
                           .message());
  };
  EXPECT_THAT(of_joint("parameters: {damping: -5}"),
              HasSubstr("joints[0].parameters.damping: is -5, must be at least 0"));
  EXPECT_THAT(of_joint("parameters: {frictionloss: -0.2}"), HasSubstr("must be at least 0"));
  EXPECT_THAT(of_joint("parameters: {mass_scale: 0}"), HasSubstr("is 0, must be above 0"));
  EXPECT_THAT(of_joint("servo: {kp: 1, torque_limit: 0}"),
              HasSubstr("joints[0].servo.torque_limit: is 0, must be above 0"));
  EXPECT_THAT(of_joint("effects: [{type: stribeck_friction, Fc: -1}]"),
              HasSubstr("joints[0].effects[0].Fc: is -1, must be at least 0"));
  EXPECT_EQ(of_joint("parameters: {damping: 0, torque_offset: -1}"), "");
  EXPECT_EQ(of_joint("effects: [{type: encoder_offset, offset: -1}]"), "");
  const auto of_log = [&](const std::string& overrides) {
    return std::string(Read(Text(kJoint, absl::StrCat("file: a.csv, overrides: {", overrides, "}")))
                           .status()
                           .message());
  };
  EXPECT_THAT(of_log("hinge.servo.kp: -20"),
              HasSubstr("logs[0].overrides.hinge.servo.kp: is -20, must be above 0"));
  EXPECT_THAT(of_log("hinge.backlash.B: -1"), HasSubstr("is -1, must be at least 0"));
}

TEST_F(RigGates, RefusesALogThatIsFittedAndHeldOutUnderTwoNames) {
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/a.csv", "t\n1\n").ok());
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/copy.csv", "t\n1\n").ok());
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/other.csv", "t\n2\n").ok());
  const auto with = [&](const std::string& file) {
    return Read(Text(kJoint, "file: a.csv") + "  - {file: " + file + ", role: held_out}\n");
  };
  for (const char* same : {"a.csv", "./a.csv", "../rig_gates/a.csv", "copy.csv"})
    EXPECT_THAT(std::string(with(same).status().message()),
                AllOf(HasSubstr("logs[1]: file '"), HasSubstr("is or copies '"),
                      HasSubstr("a.csv' of logs[0]; leave one")))
        << same;
  EXPECT_TRUE(with("other.csv").ok());
}

TEST_F(RigGates, RefusesAMetricOfWhatTheInputDoesNotCompare) {
  const auto message = [&](const std::string& input, const std::string& metric) {
    const std::string joint = "name: hinge, servo: {kp: 10}, input: " + input;
    return std::string(
        Read(Text(joint, "file: a.csv") + "metric: {type: " + metric + "}\n").status().message());
  };
  EXPECT_THAT(message("position_target", "torque_rmse"),
              HasSubstr("metric.type: is 'torque_rmse', and input position_target of joint 'hinge' "
                        "compares positions: position_rmse, position_mae"));
  EXPECT_THAT(message("inverse", "position_mae"), HasSubstr("compares torques: torque_rmse"));
  const auto rig =
      Read(Text("name: hinge, input: inverse", "file: a.csv") + "metric: {type: torque_mae}\n");
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_THAT(WriteRig(*rig), HasSubstr("torque_mae"));
}

TEST_F(RigGates, ExpandsEnvironmentVariablesInFileNames) {
  ASSERT_EQ(setenv("RIG_GATES_DATA", "/data/runs", 1), 0);
  const auto rig = Read(Text(kJoint, "file: \"${RIG_GATES_DATA}/log.csv\""));
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_EQ(rig->logs[0].file, "/data/runs/log.csv");
  ASSERT_EQ(unsetenv("RIG_GATES_DATA"), 0);
  EXPECT_THAT(
      std::string(Read(Text(kJoint, "file: \"${RIG_GATES_DATA}/log.csv\"")).status().message()),
      AllOf(HasSubstr("logs[0].file"), HasSubstr("RIG_GATES_DATA is not set")));
}

TEST_F(RigGates, RefusesAModelThatIsAbsentOrDoesNotLoadOrLacksTheJoint) {
  auto rig = Read(Text(kJoint, "file: a.csv"));
  ASSERT_TRUE(rig.ok()) << rig.status();
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()),
              AllOf(HasSubstr("m.xml"), HasSubstr("no such file")));
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/m.xml", "<mujoco><worldbody>").ok());
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()), HasSubstr("does not load"));
  ASSERT_TRUE(
      WriteFileAtomically(folder_ + "/m.xml",
                          "<mujoco><worldbody><body><joint name=\"knee\"/><geom size=\"1\"/>"
                          "</body></worldbody></mujoco>")
          .ok());
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()),
              AllOf(HasSubstr("no joint 'hinge'"), HasSubstr("knee")));
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/m.xml",
                                  "<mujoco><worldbody><body><freejoint name=\"hinge\"/>"
                                  "<geom size=\"1\"/></body></worldbody></mujoco>")
                  .ok());
  EXPECT_THAT(std::string(Plant::Load(*rig).status().message()), HasSubstr("ball or free"));
}

TEST_F(RigGates, RefusesAJointThatIsCoupledToTwoOthersOrToItself) {
  std::string mjcf = "<mujoco><worldbody>";
  for (const char* name : {"a", "b", "hinge"})
    absl::StrAppend(&mjcf, "<body><joint name=\"", name, "\"/><geom size=\"1\"/></body>");
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/m.xml", mjcf + "</worldbody></mujoco>").ok());
  const auto message = [&](const std::string& one, const std::string& other) {
    const auto rig = Read(absl::StrCat(
        "name: a\nmodel: m.xml\nrate_hz: 200\njoints:\n  - {name: a, input: torque}\n  - {name: b, "
        "input: torque}\n  - {name: hinge, input: torque, effects: [{type: cross_joint_coupling, "
        "k: 1, "
        "partner: ",
        one, "}, {type: cross_joint_inertia, J: 1, partner: ", other,
        "}]}\nlogs:\n  - {file: a.csv}\n"));
    EXPECT_TRUE(rig.ok()) << rig.status();
    const auto plant = Plant::Load(*rig);
    EXPECT_TRUE(plant.ok()) << plant.status();
    return std::string(DeclaredModel(*rig, **plant, 2).status().message());
  };
  EXPECT_EQ(message("a", "a"), "");
  EXPECT_THAT(message("a", "b"), AllOf(HasSubstr("joint 'hinge'"), HasSubstr("must be a"),
                                       HasSubstr("one other joint")));
  EXPECT_THAT(message("hinge", "hinge"), HasSubstr("must be another joint"));
}

// A reading in steps of `step` (0: none) of a joint that stands for most of a log, then sways.
std::vector<double> MostlyStanding(double noise, double step) {
  RandomStream random(StreamKey("standing"));
  std::vector<double> q(4000, 0.3);
  for (size_t i = 3000; i < q.size(); ++i) {
    q[i] += 0.2 * std::sin(0.01 * static_cast<double>(i - 3000)) + noise * random.Normal();
    if (step > 0) q[i] = step * std::round(q[i] / step);
  }
  return q;
}

TEST(NoiseTest, IsNotZeroWhereAJointStandsForMostOfALog) {
  EXPECT_NEAR(NoiseOfReading(MostlyStanding(1e-4, 0)), 1e-4, 2e-5);
  EXPECT_NEAR(NoiseOfReading(MostlyStanding(0, 1e-4)), 1e-4 / std::sqrt(12.0), 1e-5);
}

}  // namespace
}  // namespace robostress::calibration
