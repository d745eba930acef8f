#include "robot_client/recorder.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <csignal>
#include <filesystem>
#include <thread>

#include "absl/strings/str_split.h"
#include "common/atomic_file.h"
#include "common/image.h"
#include "robot_client/state_reporter.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string Fresh(const std::string& name) {
  const std::string path = ::testing::TempDir() + "/recorder_" + name;
  std::filesystem::remove_all(path);
  return path;
}

TickRecord Record(uint64_t tick, ClientState state) {
  TickRecord r;
  r.tick = tick;
  r.start_ns = static_cast<int64_t>(1e9 + static_cast<double>(tick) * 1e9 / 30);
  r.due_ns = r.start_ns - 12'000;
  r.sent_ns = r.start_ns + 30'000;
  r.state = state;
  r.sequence = tick;
  r.sent.fill(0.25);
  r.policy.fill(0.5);
  return r;
}

TEST(RecorderTest, ATableHasTheColumnsOfItsArmsAxesAndNoOther) {
  const std::string piper = Recorder::Header(ArmAxes());
  EXPECT_THAT(piper,
              HasSubstr(",sent_J1,sent_J2,sent_J3,sent_J4,sent_J5,sent_J6,sent_gripper,q_J1"));
  EXPECT_EQ(std::count(piper.begin(), piper.end(), ','), 15 + 9 * 7 + 1);
  for (const ArmAxes& axes : {ArmAxes{7, true}, ArmAxes{7, false}, ArmAxes{5, true}}) {
    const std::string directory = Fresh("axes");
    auto recorder = Recorder::Create(directory, axes);
    ASSERT_TRUE(recorder.ok()) << recorder.status();
    TickRecord record = Record(1, ClientState::kRun);
    record.axes = axes;
    record.position = {1, 2, 3, 4, 5, 6, 7, 8};
    ArmSnapshot sample;
    sample.position = record.position;
    (*recorder)->ring().Push(record);
    (*recorder)->samples().Push(sample);
    ASSERT_TRUE((*recorder)->Finish().ok());
    for (const char* table : {"/ticks.csv", "/samples.csv"}) {
      const std::vector<std::string> lines =
          absl::StrSplit(*ReadFile(directory + table), '\n', absl::SkipEmpty());
      ASSERT_EQ(lines.size(), 2u);
      const std::vector<std::string> names = absl::StrSplit(lines[0], ',');
      const std::vector<std::string> fields = absl::StrSplit(lines[1], ',');
      ASSERT_EQ(names.size(), fields.size()) << axes.text();
      const auto first = std::find(names.begin(), names.end(), "q_J1") - names.begin();
      for (int i = 0; i < axes.count(); ++i) {
        EXPECT_EQ(names[static_cast<size_t>(first + i)], "q_" + axes.name(i));
        EXPECT_EQ(fields[static_cast<size_t>(first + i)], std::to_string(i + 1));
      }
      EXPECT_EQ(names[static_cast<size_t>(first + axes.count())], "dq_J1");
    }
  }
}

TEST(RecorderTest, WhatIsSaidOfAPressNamesTheLastJointAndNeverTheGripper) {
  TickRecord record = Record(1, ClientState::kHold);
  record.axes = {7, true};
  record.cause = StateCause::kBlocked;
  record.position.fill(0.25);
  record.position[6] = 0.05;
  record.position[7] = -3;
  EXPECT_THAT(CauseText(record), HasSubstr("J7 is 0.200 rad off"));
  record.axes = {};
  record.position[5] = 0.15;
  EXPECT_THAT(CauseText(record), HasSubstr("J6 is 0.100 rad off")) << "the seventh is a gripper";
}

TEST(RecorderTest, WritesARowPerTickUnderAHeaderThatNamesEveryColumn) {
  const std::string directory = Fresh("rows");
  auto recorder = Recorder::Create(directory);
  ASSERT_TRUE(recorder.ok()) << recorder.status();
  TickRecord record = Record(1, ClientState::kRun);
  record.flags = kTickPlayed;
  (*recorder)->ring().Push(Record(0, ClientState::kIdle));
  (*recorder)->ring().Push(record);
  ASSERT_TRUE((*recorder)->Finish().ok());
  const std::vector<std::string> lines =
      absl::StrSplit(*ReadFile(directory + "/ticks.csv"), '\n', absl::SkipEmpty());
  ASSERT_EQ(lines.size(), 3u);
  const std::vector<std::string> names = absl::StrSplit(lines[0], ',');
  const auto column = [&names](const std::string& row, const std::string& name) {
    const std::vector<std::string> fields = absl::StrSplit(row, ',');
    EXPECT_EQ(fields.size(), names.size());
    return fields[static_cast<size_t>(std::find(names.begin(), names.end(), name) - names.begin())];
  };
  EXPECT_EQ(column(lines[2], "policy_J3"), "0.5");
  EXPECT_EQ(column(lines[2], "sent_gripper"), "0.25");
  EXPECT_EQ(column(lines[2], "state"), "RUN");
  EXPECT_EQ(column(lines[2], "wake_us"), "12.0");
  EXPECT_EQ(column(lines[2], "sent_us"), "42.0");
  EXPECT_EQ(column(lines[1], "policy_J3"), "") << "no policy played";
  EXPECT_EQ(column(lines[1], "sent_J1"), "") << "nothing was sent in IDLE";
}

TEST(RecorderTest, WritesWhichPictureEachPredictionSawAndItsAge) {
  const std::string directory = Fresh("frames");
  auto recorder = Recorder::Create(directory);
  ASSERT_TRUE(recorder.ok()) << recorder.status();
  (*recorder)->ring().Push(Record(0, ClientState::kRun));  // begins at 1 s
  FrameRecord frame{7, (uint64_t{2} << 48) | 5, 1, 3};
  std::string("wrist").copy(frame.camera.data(), 31);
  frame.use = FrameUse::kShown;
  frame.sequence = 41;
  frame.stamp_ns = 1'990'000'000;
  frame.observed_ns = 2'031'500'000;
  (*recorder)->frames().Push(frame);
  frame.picture = std::make_shared<Image>(Image{2, 1, {1, 2, 3, 250, 251, 252}});
  frame.request = 8;
  std::string("side/left").copy(frame.camera.data(), 31);
  (*recorder)->frames().Push(frame);
  frame.picture = nullptr;
  frame.prediction_id = 0;
  frame.use = FrameUse::kMissing;
  (*recorder)->frames().Push(frame);
  ASSERT_TRUE((*recorder)->Finish().ok());
  EXPECT_EQ(*ReadFile(directory + "/frames.csv"),
            "t,request,prediction,episode,chunk,camera,use,sequence,stamp,age_ms,picture\n"
            "1.031500000,7,5,1,3,wrist,shown,41,0.990000000,41.500,\n"
            "1.031500000,8,5,1,3,side/left,shown,41,0.990000000,41.500,"
            "pictures/000008_side_left.png\n"
            "1.031500000,8,,1,3,side/left,missing,,,,\n");
  const auto kept = DecodePng(*ReadFile(directory + "/pictures/000008_side_left.png"));
  ASSERT_TRUE(kept.ok()) << kept.status();
  EXPECT_EQ(kept->data, (std::vector<uint8_t>{1, 2, 3, 250, 251, 252}));
  EXPECT_FALSE(std::filesystem::exists(directory + "/frames.csv.partial"));
}

TEST(RecorderTest, SaysWhyTheStateChanged) {
  const std::string directory = Fresh("events");
  auto recorder = Recorder::Create(directory);
  ASSERT_TRUE(recorder.ok());
  (*recorder)->ring().Push(Record(0, ClientState::kRun));
  TickRecord fault = Record(1, ClientState::kFault);
  fault.cause = StateCause::kArmFault;
  fault.faults = kFaultCollision | kFaultStall;
  fault.fault_joints = 1 << 1;
  (*recorder)->ring().Push(fault);
  (*recorder)->ring().Push(fault);
  ASSERT_TRUE((*recorder)->Drain().ok());
  const std::vector<std::string> events =
      absl::StrSplit(*ReadFile(directory + "/events.jsonl"), '\n', absl::SkipEmpty());
  ASSERT_EQ(events.size(), 3u) << "once per change";
  EXPECT_THAT(events[0], HasSubstr("\"monotonic_ns\":1000000000"));
  EXPECT_THAT(events[2], HasSubstr("\"cause\":\"arm_fault\""));
  EXPECT_THAT(events[2], HasSubstr("collision, stalled motor (J2)"));
}

TEST(StateReporterTest, TellsStateCauseAndWhatToTypeNext) {
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  StateReporter reporter(ends[1]);
  TickRecord fault = Record(30, ClientState::kFault);
  fault.cause = StateCause::kArmFault;
  fault.faults = kFaultDriver;
  fault.fault_joints = 1 << 4;
  TickRecord pressing = Record(31, ClientState::kHold);
  pressing.cause = StateCause::kPressing;
  pressing.excess[1] = -9.25;
  reporter.ring().Push(Record(0, ClientState::kIdle));
  reporter.ring().Push(fault);
  reporter.ring().Push(fault);
  reporter.ring().Push(pressing);
  reporter.Say("said");
  reporter.Drain();
  char text[2000];
  const ssize_t size = read(ends[0], text, sizeof text);
  ASSERT_GT(size, 0);
  const std::string told(text, static_cast<size_t>(size));
  EXPECT_THAT(told, HasSubstr("1.000 s  FAULT (arm_fault): driver or sensor error (J5); remove the "
                              "cause, then type clear, then enable\n"));
  EXPECT_THAT(told, HasSubstr("HOLD (pressing): J2 presses with 9.2 Nm more than its motion needs; "
                              "clear the arm's way, then type resume or end\n"));
  EXPECT_THAT(told, HasSubstr("said\n"));
  close(ends[0]);
  close(ends[1]);
}

TEST(StateReporterTest, AnOutputThatIsStuckOrClosedCostsLinesAndNothingElse) {
  std::signal(SIGPIPE, SIG_IGN);
  int ends[2];
  ASSERT_EQ(pipe(ends), 0);
  StateReporter reporter(ends[1]);
  const auto begin = std::chrono::steady_clock::now();
  for (int i = 0; i < 3000; ++i) reporter.Say(std::string(100, 'x'));  // 300 kB into 64 KiB
  for (int i = 0; i < 3; ++i) reporter.Drain();
  close(ends[0]);
  reporter.Say("to nobody");
  reporter.Drain();
  EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(2));
  close(ends[1]);
}

TEST(RecorderTest, AFailureIsToldAtOnceAndOnlyOnce) {
  const std::string directory = Fresh("full");
  auto recorder = Recorder::Create(directory);
  ASSERT_TRUE(recorder.ok());
  std::filesystem::remove_all(directory);  // events.jsonl has no place any more
  std::atomic<bool> stop{false};
  std::atomic<int> told{0};
  absl::Status result;
  std::thread thread(
      [&] { result = (*recorder)->Run(stop, [&](const absl::Status&) { ++told; }); });
  for (uint64_t i = 0; i < 10; ++i) {
    (*recorder)->ring().Push(Record(i, i % 2 == 0 ? ClientState::kRun : ClientState::kHold));
    std::this_thread::sleep_for(std::chrono::milliseconds(30));
  }
  stop = true;
  thread.join();
  EXPECT_EQ(told, 1);
  EXPECT_FALSE(result.ok());
}

TEST(RecorderTest, AnUnfinishedRecordingDoesNotLookWhole) {
  const std::string directory = Fresh("partial");
  {
    auto recorder = Recorder::Create(directory);
    ASSERT_TRUE(recorder.ok());
    (*recorder)->ring().Push(Record(0, ClientState::kRun));
    ASSERT_TRUE((*recorder)->Drain().ok());
  }
  EXPECT_FALSE(std::filesystem::exists(directory + "/ticks.csv"));
  EXPECT_TRUE(std::filesystem::exists(directory + "/ticks.csv.partial"));
  EXPECT_EQ(Recorder::Create(directory).status().code(), absl::StatusCode::kAlreadyExists)
      << "and is never overwritten";
}

}  // namespace
}  // namespace robostress
