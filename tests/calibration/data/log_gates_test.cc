#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <functional>

#include "absl/strings/str_cat.h"
#include "calibration/data/local_polynomial.h"
#include "calibration/data/measured_log.h"
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
  EXPECT_THAT(Refusal(with_velocity(30 / M_PI)),
              HasSubstr("turns a minute: multiply them by 0.10472"));
  EXPECT_THAT(Refusal(with_velocity(-1)), HasSubstr("counts the other way: multiply them by -1"));
  EXPECT_THAT(Refusal(with_velocity(7)), HasSubstr("no velocity of this joint's motor"));
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
