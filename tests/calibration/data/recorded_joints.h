#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "calibration/data/recording_rig.h"
#include "calibration/data/recording_text.h"
#include "common/csv_table.h"
#include "common/recordings/joint_messages.h"
#include "common/recordings/recording.h"
#include "tests/common/recordings/recording_bytes.h"

namespace robostress::calibration::recorded_test {

inline constexpr int64_t kStart = 1'700'000'000'000'000'000;
inline constexpr int64_t kTick = 10'000'000;  // 100 Hz

// A recording that a test fills message by message.
class Recorder {
 public:
  void JointState(int64_t log_ns, const recording_test::JointStateFields& fields) {
    messages_ += recording_test::McapMessageRecord(1, static_cast<uint64_t>(log_ns),
                                                   recording_test::JointStateBytes(fields));
  }
  void Command(int64_t log_ns, const std::vector<double>& data) {
    recording_test::CdrBytes bytes;
    bytes.Add(uint32_t{0}).Add(uint32_t{0}).Numbers(data);
    messages_ +=
        recording_test::McapMessageRecord(2, static_cast<uint64_t>(log_ns), bytes.Message());
  }
  // A controller's state in the layout of old, by default of a command alone.
  void Reference(int64_t log_ns, int64_t stamp_ns, const std::string& joint, double position,
                 const std::vector<double>& measured = {}) {
    recording_test::CdrBytes bytes;
    bytes.Add(static_cast<int32_t>(stamp_ns / 1'000'000'000));
    bytes.Add(static_cast<uint32_t>(stamp_ns % 1'000'000'000)).Text("").Texts({joint});
    for (const std::vector<double>& positions : {std::vector<double>{position}, measured, {}}) {
      bytes.Numbers(positions).Numbers({}).Numbers({}).Numbers({});
      bytes.Add(int32_t{0}).Add(uint32_t{0});
    }
    messages_ +=
        recording_test::McapMessageRecord(3, static_cast<uint64_t>(log_ns), bytes.Message());
  }
  // On a topic of its own: another arm, or commands with names. channel: 4, or one of `more`.
  void Other(int64_t log_ns, const recording_test::JointStateFields& fields, uint16_t channel = 4) {
    messages_ += recording_test::McapMessageRecord(channel, static_cast<uint64_t>(log_ns),
                                                   recording_test::JointStateBytes(fields));
  }
  // more: topics of joint states, the channels from 5 on.
  std::string Write(const std::string& name, const std::string& other = "/leader/joints",
                    const std::vector<std::string>& more_topics = {}) const {
    std::string more;
    for (size_t i = 0; i < more_topics.size(); ++i)
      more += recording_test::McapChannelRecord(static_cast<uint16_t>(5 + i), 1, more_topics[i]);
    const std::string path = testing::TempDir() + "/" + name + ".mcap";
    std::ofstream(path, std::ios::binary)
        << recording_test::McapMagic()
        << recording_test::McapSchemaRecord(1, "sensor_msgs/msg/JointState",
                                            recording_test::JointStateText())
        << recording_test::McapSchemaRecord(2, "std_msgs/msg/Float64MultiArray",
                                            KnownDefinitions(JointMessageKind::kArray)[0])
        << recording_test::McapChannelRecord(1, 1, "/joint_states")
        << recording_test::McapChannelRecord(2, 2, "/commands")
        << recording_test::McapChannelRecord(4, 1, other) << more
        << recording_test::McapSchemaRecord(
               3, "control_msgs/msg/JointTrajectoryControllerState",
               KnownDefinitions(JointMessageKind::kControllerState).back())
        << recording_test::McapChannelRecord(3, 3, "/controller_state")
        << recording_test::McapChunk("zstd", messages_) << recording_test::McapEnd();
    return path;
  }

 private:
  std::string messages_;
};

inline double Angle(int i, double phase) { return 0.8 * std::sin(0.02 * i + phase); }

// Two joints that follow commands a tick later; the recorder is up to 3 ms late.
inline std::string Following(const std::string& name, int rows) {
  Recorder recorder;
  for (int i = 0; i < rows; ++i) {
    const int64_t t = kStart + i * kTick;
    recorder.Command(t, {Angle(i + 3, 0), Angle(i + 3, 1)});
    recorder.JointState(t + (i * 7 % 4) * 1'000'000,
                        {t, {"lift", "turn", "still"}, {Angle(i, 1), Angle(i, 0), 0.3}});
  }
  return recorder.Write(name);
}

struct Result {
  RecordingStatistics statistics;
  RecordingPlan plan;
  RecordingRigSummary summary;
  std::string folder, text;
};

inline absl::StatusOr<RecordingPlan> Plan(const std::string& recording,
                                          const RecordingOptions& options,
                                          RecordingStatistics* statistics) {
  const absl::Status read = ReadRecording(recording, {}, statistics);
  if (!read.ok()) return read;
  return PlanRecording(*statistics, options);
}

inline Result Inspect(const std::string& recording, const RecordingOptions& options = {},
                      const std::optional<Rig>& declared = std::nullopt) {
  Result result;
  const auto plan = Plan(recording, options, &result.statistics);
  EXPECT_TRUE(plan.ok()) << plan.status();
  if (!plan.ok()) return result;
  result.plan = *plan;
  result.text = DescribeRecording(result.statistics, result.plan);
  if (result.plan.joints.empty()) return result;
  result.folder = recording + "_rig";
  std::filesystem::remove_all(result.folder);
  const auto summary = WriteRecordingRig(recording, result.plan, declared, result.folder);
  EXPECT_TRUE(summary.ok()) << summary.status();
  if (summary.ok()) result.summary = *summary;
  return result;
}

inline std::vector<double> Column(const Result& result, const std::string& name, int log = 0) {
  const auto table = CsvTable::Read(absl::StrCat(result.folder, "/log_", log, ".csv"));
  EXPECT_TRUE(table.ok()) << table.status();
  const auto numbers = table->Numbers(name);
  EXPECT_TRUE(numbers.ok()) << numbers.status();
  return numbers.ok() ? *numbers : std::vector<double>();
}

}  // namespace robostress::calibration::recorded_test
