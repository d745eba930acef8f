#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "calibration/data/recording_rig.h"
#include "tests/calibration/data/recorded_joints.h"

namespace robostress::calibration {
namespace {

using namespace recorded_test;  // NOLINT(google-build-using-namespace)
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::Not;
using ::testing::SizeIs;

constexpr int64_t kSecond = 1'000'000'000;

// Of all logs: the largest difference of the command from `lead` rows ahead of the position, which
// says its row itself: q = i / 1000.
double WorstCommand(const Result& result, double lead) {
  double worst = 0;
  for (int log = 0; log < result.summary.logs; ++log) {
    const std::vector<double> q = Column(result, "q_a", log), cmd = Column(result, "q_cmd_a", log);
    for (size_t i = 0; i < q.size(); ++i)
      worst = std::max(worst, std::abs(cmd[i] - q[i] - lead / 1000));
  }
  return worst;
}

size_t Rows(const Result& result) {
  size_t rows = 0;
  for (int log = 0; log < result.summary.logs; ++log) rows += Column(result, "t", log).size();
  return rows;
}

// 6000 rows of one joint under commands of two rows later. stamp, log: what the clocks say at i.
template <typename Stamp, typename CommandStamp, typename Log>
Result Recorded(const std::string& name, Stamp stamp, CommandStamp command_stamp, Log log) {
  Recorder recorder;
  for (int i = 0; i < 6000; ++i) {
    recorder.Other(log(i), {command_stamp(i), {"a"}, {(i + 2) / 1000.0}});
    recorder.JointState(log(i) + 200'000, {stamp(i) + 50'000, {"a"}, {i / 1000.0}});
  }
  return Inspect(recorder.Write(name, "/arm/joint_command"));
}

int64_t Plain(int i) { return kStart + i * kTick; }

TEST(RecordingClocksTest, GoesOnBehindAClockThatWasSet) {
  for (const int64_t jump : {-10 * kSecond, 10 * kSecond}) {
    const auto set = [&](int i) { return Plain(i) + (i < 3000 ? 0 : jump); };
    for (const bool recorder_too : {false, true}) {
      const Result result =
          recorder_too ? Recorded("set_all", set, set, set) : Recorded("set", set, set, Plain);
      EXPECT_LT(WorstCommand(result, 2), 1e-9) << jump << recorder_too;
      EXPECT_GT(Rows(result), 5980);
      // No log has rows of both sides: q counts them.
      for (int log = 0; log < result.summary.logs; ++log) {
        const std::vector<double> q = Column(result, "q_a", log), t = Column(result, "t", log);
        EXPECT_NEAR(t.back(), 10 * (q.back() - q.front()), 1e-6);
      }
    }
  }
}

TEST(RecordingClocksTest, GoesOnBehindASimulationThatWasReset) {
  const auto sim = [](int i) { return (i % 2000) * kTick + 20'000'000; };
  const Result result = Recorded("reset", sim, sim, Plain);
  EXPECT_LT(WorstCommand(result, 2), 1e-9);
  EXPECT_GT(Rows(result), 5950);
}

TEST(RecordingClocksTest, LeavesOutOneWrongStampAndNoMore) {
  const auto wrong = [](int i) { return Plain(i) + (i == 3000 ? 3600 * kSecond : 0); };
  const Result command = Recorded("wrong_command", Plain, wrong, Plain);
  EXPECT_LT(WorstCommand(command, 2), 1e-9);
  EXPECT_EQ(Rows(command), 6000);
  const Result position = Recorded("wrong_position", wrong, Plain, Plain);
  EXPECT_LT(WorstCommand(position, 2), 1e-9);
  EXPECT_EQ(Rows(position), 5999);
  EXPECT_EQ(position.summary.wrong_stamps, 1);
}

// The commands' computer is wrong by a third of a second, or by a day.
TEST(RecordingClocksTest, ComparesCommandsOfAnotherClockByTheRecordersTimes) {
  for (const int64_t off : {kSecond / 3, -kSecond / 3, 86400 * kSecond}) {
    const auto other = [&](int i) { return Plain(i) + off; };
    const Result result = Recorded("another_clock", Plain, other, Plain);
    EXPECT_LT(WorstCommand(result, 2), 1e-9) << off;
    EXPECT_GT(Rows(result), 5990);
    EXPECT_THAT(result.text,
                AllOf(HasSubstr("by the recorder's times: two clocks?"),
                      HasSubstr("stand by the recorder's times; --command-times stamps"),
                      HasSubstr(off > 0 ? "s ahead of those" : "s behind those")));
  }
}

// However they come to the recorder: late, in batches, sometimes later.
TEST(RecordingClocksTest, LeavesCommandsAtTheirStampsWhereTheWayIsSlow) {
  const auto recorded = [](const std::string& name, auto late) {
    std::vector<std::pair<int64_t, int>>
        order;  // when, which: the command of row i is i, its row -i - 1
    for (int i = 0; i < 6000; ++i) {
      order.emplace_back(Plain(i) + late(i), i);
      order.emplace_back(Plain(i) + 1, -i - 1);
    }
    std::stable_sort(order.begin(), order.end());
    Recorder recorder;
    for (const auto& [at, i] : order) {
      if (i >= 0)
        recorder.Other(at, {Plain(i), {"a"}, {(i + 2) / 1000.0}});
      else
        recorder.JointState(at, {Plain(-i - 1) + 1, {"a"}, {(-i - 1) / 1000.0}});
    }
    return Inspect(recorder.Write(name, "/arm/joint_command"));
  };
  const int64_t ms = 1'000'000;
  const Result late = recorded("late", [&](int) { return 80 * ms; });
  EXPECT_LT(WorstCommand(late, 2), 1e-9);
  EXPECT_THAT(late.text, HasSubstr("stand by their stamps; --command-times recorder"));
  const Result batches = recorded("batches", [&](int i) { return (20 - i % 20) * 10 * ms; });
  EXPECT_LT(WorstCommand(batches, 2), 1e-9);
  EXPECT_THAT(batches.text, HasSubstr("give or take"));
  const Result drifting = recorded(
      "drifting", [&](int i) { return (50 + static_cast<int64_t>(20 * std::sin(0.01 * i))) * ms; });
  EXPECT_LT(WorstCommand(drifting, 2), 1e-9);
}

TEST(RecordingClocksTest, LeavesOutARowWithoutAStamp) {
  const auto first = [](int i) { return i == 0 ? -50'000 : Plain(i); };
  const Result result = Recorded("first_zero", first, Plain, [](int i) { return 2 * i * kTick; });
  EXPECT_TRUE(result.plan.by_stamp);
  EXPECT_EQ(result.plan.rate_hz, 100);
  EXPECT_EQ(Rows(result), 5999);
  EXPECT_THAT(result.text, HasSubstr("1 of 6000 rows have no header.stamp; they are left out"));
}

// Stamps that vary by two hundredths of a row.
TEST(RecordingClocksTest, FindsTheRateBehindJitter) {
  for (const int hz : {30, 50, 100, 125, 200, 250, 500, 1000}) {
    Recorder recorder;
    for (int i = 0; i < 4000; ++i) {
      const int64_t t =
          kStart +
          static_cast<int64_t>((i + 0.04 * std::sin(1.7 * i + 0.3 * std::sin(0.9 * i))) * 1e9 / hz);
      recorder.JointState(t, {t, {"a"}, {Angle(i, 0)}, {}, {Angle(i, 1)}});
    }
    EXPECT_EQ(Inspect(recorder.Write("jitter")).plan.rate_hz, hz);
  }
}

// A gripper's messages come between the arm's, on the same topic.
TEST(RecordingClocksTest, TakesTheRateOfTheRowsThatItTakes) {
  for (const int64_t behind : {2'000'000, 5'000'000}) {
    Recorder recorder;
    for (int i = 0; i < 4000; ++i) {
      const int64_t t = Plain(i);
      recorder.Command(t, {Angle(i, 0.1)});
      recorder.JointState(t + 1, {t + 1, {"a"}, {Angle(i, 0)}});
      if (i % 10 != 9) recorder.JointState(t + behind, {t + behind, {"finger"}, {0.02 * (i % 7)}});
    }
    const Result result = Inspect(recorder.Write("two_on_a_topic"));
    EXPECT_EQ(result.plan.rate_hz, 100);
    EXPECT_EQ(Rows(result), 4000);
  }
}

// Two arms with the same names, of which the other one's commands are more.
TEST(RecordingClocksTest, TakesTheCommandsOfTheArmsOwnNamespaceOrTheNearest) {
  for (const bool named : {false, true}) {
    Recorder recorder;
    for (int i = 0; i < 3000; ++i) {
      const int64_t t = Plain(i);
      recorder.Other(t, {t, {"a"}, {Angle(i, 0.2)}}, 5);
      recorder.Other(t + 1, {t + 1, {"a"}, {Angle(i, named ? 0.25 : 0.05)}}, 6);
      recorder.Other(t + 2, {t + 2, {"a"}, {Angle(i, 0)}}, 4);
      if (i < 20) recorder.Other(t + 3, {t + 3, {"a"}, {Angle(i, 0.2)}}, 5);
    }
    const Result result =
        named ? Inspect(recorder.Write("two_arms", "/left/joint_states",
                                       {"/right/joint_command", "/left/joint_command"}))
              : Inspect(recorder.Write("two_commands", "/states",
                                       {"/joint_command", "/safe/joint_command"}));
    ASSERT_THAT(result.plan.joints, SizeIs(1));
    EXPECT_EQ(Column(result, "q_cmd_a")[50], Angle(50, named ? 0.25 : 0.05)) << result.text;
    EXPECT_THAT(result.text, HasSubstr(named ? "of 2 that do, has the topic that is nearest"
                                             : "of 2 that do, stays nearest"));
  }
}

// However many messages another topic has: a leader's, for one.
TEST(RecordingClocksTest, PrefersTheReferenceInThePositionsOwnRow) {
  Recorder recorder;
  for (int i = 0; i < 3000; ++i) {
    recorder.Reference(Plain(i), Plain(i), "a", Angle(i, 0.1), {Angle(i, 0)});
    for (int k = 0; k < 3; ++k)
      recorder.Other(Plain(i) + k, {Plain(i) + k, {"a"}, {Angle(i, 0.05)}});
  }
  const Result result = Inspect(recorder.Write("own_row", "/leader/joint_command"));
  ASSERT_THAT(result.plan.joints, SizeIs(1));
  EXPECT_TRUE(result.plan.joints[0].command_in_row);
  EXPECT_THAT(result.text, HasSubstr("of 2 that do, stands in the positions' rows"));
}

Rig Declared(JointInput input) {
  Rig rig;
  rig.file = testing::TempDir() + "/declared_input/rig.yaml";
  rig.name = "bench";
  rig.model = testing::TempDir() + "/declared_input/arm.xml";
  RigJoint joint;
  joint.name = "a";
  joint.input = input;
  if (input == JointInput::kPositionTarget) joint.servo.kp = 50;
  rig.joints.push_back(joint);
  return rig;
}

TEST(RecordingClocksTest, KeepsTheInputOfARigThatIsTakenOver) {
  Recorder both, no_effort, effort_at_times;
  for (int i = 0; i < 3000; ++i) {
    const int64_t t = Plain(i);
    for (Recorder* recorder : {&both, &no_effort, &effort_at_times})
      recorder->Command(t, {Angle(i, 0.1)});
    both.JointState(t, {t, {"a"}, {Angle(i, 0)}, {}, {Angle(i, 2)}});
    no_effort.JointState(t, {t, {"a"}, {Angle(i, 0)}});
    effort_at_times.JointState(t,
                               {t,
                                {"a"},
                                {Angle(i, 0)},
                                {},
                                i % 1000 == 3 ? std::vector{Angle(i, 2)} : std::vector<double>()});
  }
  for (const JointInput input :
       {JointInput::kPositionTarget, JointInput::kTorque, JointInput::kInverse}) {
    RecordingOptions options;
    options.inputs = {{"a", input}};
    const Result result = Inspect(both.Write("both"), options, Declared(input));
    const auto rig = ReadRig(result.summary.rig_file);
    ASSERT_TRUE(rig.ok()) << rig.status();
    EXPECT_EQ(rig->joints.at(0).input, input);
    const Result lacks = Inspect(no_effort.Write("no_effort"), options, Declared(input));
    if (input == JointInput::kPositionTarget)
      EXPECT_THAT(lacks.plan.joints, SizeIs(1));
    else
      EXPECT_THAT(lacks.plan.why_none,
                  HasSubstr("driven by torques, which the recording does not have"));
  }
  RecordingOptions options;
  options.inputs = {{"a", JointInput::kTransmission}};
  RecordingStatistics statistics;
  EXPECT_THAT(std::string(Plan(both.Write("both"), options, &statistics).status().message()),
              HasSubstr("input: transmission, which compares q_motor and q_link"));
  const Result at_times = Inspect(effort_at_times.Write("effort_at_times"));
  EXPECT_THAT(at_times.text, HasSubstr("effort of a stands in 3 of 3000 rows and is left out"));
  EXPECT_EQ(Rows(at_times), 3000);
}

// A reference in the state of the position's own controller is one however far it is.
TEST(RecordingClocksTest, TakesStepsOfAReference) {
  Recorder beside, apart;
  double q = 0;
  for (int i = 0; i < 6000; ++i) {
    const double command = i / 100 % 2 == 0 ? 0.5 : 0;
    q += (command - q) * 0.04;
    beside.Reference(Plain(i), Plain(i), "a", command, {q});
    apart.Other(Plain(i), {Plain(i), {"a"}, {command}});
    apart.JointState(Plain(i) + 1, {Plain(i) + 1, {"a"}, {q}});
  }
  EXPECT_THAT(Inspect(beside.Write("steps_beside")).plan.joints, SizeIs(1));
  const std::string recording = apart.Write("steps_apart", "/arm/joint_command");
  const Result far = Inspect(recording);
  EXPECT_THAT(far.plan.joints, IsEmpty());
  EXPECT_THAT(far.text, HasSubstr("It is not taken; --commands /arm/joint_command takes it"));
  RecordingOptions options;
  options.commands = "/arm/joint_command";
  EXPECT_THAT(Inspect(recording, options).plan.joints, SizeIs(1));
  Recorder unnamed;
  for (int i = 0; i < 6000; ++i) {
    unnamed.Command(Plain(i), {i / 100 % 2 == 0 ? 0.5 : 0.0});
    unnamed.JointState(Plain(i) + 1, {Plain(i) + 1, {"a"}, {0.25 + 0.25 * std::sin(0.0314 * i)}});
  }
  const std::string array = unnamed.Write("steps_unnamed");
  EXPECT_THAT(Inspect(array).plan.joints, IsEmpty());
  options.commands = "/commands";
  EXPECT_THAT(Inspect(array, options).plan.joints, SizeIs(1));
  options.commands = "/none";
  RecordingStatistics statistics;
  EXPECT_THAT(
      std::string(Plan(recording, options, &statistics).status().message()),
      HasSubstr(
          "--commands: '/none' holds no commands of joints; those that do: /arm/joint_command"));
}

// Percent and degrees side by side, and a gripper.
TEST(RecordingClocksTest, TakesAUnitOfEveryJoint) {
  std::string text = "t,q_pan,q_cmd_pan,q_lift,q_cmd_lift,q_gripper,q_cmd_gripper\n";
  for (int i = 0; i < 3000; ++i)
    absl::StrAppend(&text, i * 0.01, ",", Angle(i, 0), ",", Angle(i, 0.1), ",", Angle(i, 1), ",",
                    Angle(i, 1.1), ",", 50 + 40 * Angle(i, 0), ",", 50 + 40 * Angle(i, 0.1), "\n");
  const std::string recording = testing::TempDir() + "/units.csv";
  std::ofstream(recording) << text;
  RecordingOptions options;
  options.to_rad_of = {{"pan", 2}, {"lift", 3}};
  const Result result = Inspect(recording, options);
  ASSERT_THAT(result.plan.joints, SizeIs(3)) << "a CSV's gripper has a unit";
  EXPECT_NEAR(Column(result, "q_pan")[9], 2 * Angle(9, 0), 1e-6);
  EXPECT_NEAR(Column(result, "q_cmd_lift")[9], 3 * Angle(9, 1.1), 1e-6);
  options.to_rad_of = {{"pna", 2}};
  RecordingStatistics statistics;
  EXPECT_THAT(std::string(Plan(recording, options, &statistics).status().message()),
              HasSubstr("--unit: 'pna' is not in"));
}

TEST(RecordingClocksTest, NamesAModelThatAFolderReachedByALinkFinds) {
  const std::string recording = Following("linked", 3000);
  const std::string root = testing::TempDir() + "/linked_rigs";
  std::filesystem::remove_all(root);
  std::filesystem::create_directories(root + "/far/away/disk");
  std::filesystem::create_directories(root + "/arm #2");
  std::ofstream(root + "/arm #2/arm.xml") << "<mujoco/>";
  std::filesystem::create_directory_symlink(root + "/far/away/disk", root + "/runs");
  for (const char* out : {"/runs/rig", "/rig"}) {
    RecordingStatistics statistics;
    auto plan = Plan(recording, {}, &statistics);
    ASSERT_TRUE(plan.ok()) << plan.status();
    plan->model = root + "/arm #2/arm.xml";
    const auto summary = WriteRecordingRig(recording, *plan, std::nullopt, root + out);
    ASSERT_TRUE(summary.ok()) << summary.status();
    const auto text = ReadFile(summary->rig_file);
    ASSERT_TRUE(text.ok());
    const std::string line = text->substr(text->find("model: \"") + 8);
    const std::string named = line.substr(0, line.find('"'));
    EXPECT_TRUE(std::filesystem::exists(root + out + "/" + named)) << line;
  }
}

}  // namespace
}  // namespace robostress::calibration
