#include "common/records/episode_recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "common/atomic_file.h"
#include "common/random.h"
#include "common/safetensors.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

std::string Place(const std::string& name) {
  return ::testing::TempDir() + "/recording_" + name + ".safetensors";
}

EpisodeRecording Recording(int steps) {
  RandomStream random(StreamKey("recording"));
  const auto draw = [&random](int n) {
    Eigen::VectorXd values(n);
    for (int i = 0; i < n; ++i) values[i] = random.Normal();
    return values;
  };
  EpisodeRecording recording;
  recording.suite = "tabletop_goal", recording.scenario = "heavy_payload";
  recording.policy = "nano", recording.method = "ours", recording.task_name = "open_it";
  recording.instruction = "open it", recording.model_file = "<mujoco/>";
  recording.severity = 3, recording.task = 4, recording.episode = 5, recording.initial_state = 45;
  recording.seed = 6, recording.success = true;
  recording.cameras = {"agentview", "robot0_eye_in_hand"};
  recording.pictures.resize(2);
  for (int t = 0; t < steps; ++t) {
    EpisodeRecording::Step& step = recording.steps.emplace_back();
    step.before.q = draw(7), step.before.dq = draw(7), step.before.gripper = random.Normal();
    step.before.tool.p_base_tool = draw(3);
    step.before.tool.q_base_tool = Eigen::Quaterniond(0.5, -0.5, 0.5, 0.5);
    step.proprioception = draw(8).cast<float>();
    step.commanded = draw(7).cast<float>(), step.sent = draw(7).cast<float>();
    step.measured = draw(7).cast<float>();
    SimulatorRow& row = step.simulator;
    const auto fill = [&random](auto& values) {
      for (double& v : values) v = random.Normal();
    };
    row.state.resize(11);
    fill(row.state), fill(row.fingers), fill(row.ee_pos), fill(row.ee_ori), fill(row.ee_quat);
    std::copy_n(step.before.q.begin(), 7, row.joints.begin());
    for (int c = 0; c < 2; ++c)
      recording.pictures[c].push_back(std::string(static_cast<size_t>(1 + t + c), 'a' + t));
  }
  return recording;
}

TEST(EpisodeRecording, IsReadAsItWasWritten) {
  const EpisodeRecording written = Recording(3);
  ASSERT_TRUE(WriteEpisodeRecording(written, Place("whole")).ok());
  const auto read = ReadEpisodeRecording(Place("whole"));
  ASSERT_TRUE(read.ok()) << read.status();
  for (const auto member :
       {&EpisodeRecording::suite, &EpisodeRecording::scenario, &EpisodeRecording::policy,
        &EpisodeRecording::method, &EpisodeRecording::task_name, &EpisodeRecording::instruction,
        &EpisodeRecording::model_file})
    EXPECT_EQ(*read.*member, written.*member);
  for (const auto member : {&EpisodeRecording::severity, &EpisodeRecording::task,
                            &EpisodeRecording::episode, &EpisodeRecording::initial_state})
    EXPECT_EQ(*read.*member, written.*member);
  EXPECT_EQ(read->seed, 6);
  EXPECT_TRUE(read->success);
  EXPECT_EQ(read->rate_hz, 20);
  EXPECT_EQ(read->cameras, written.cameras);
  EXPECT_EQ(read->pictures, written.pictures);
  ASSERT_EQ(read->steps.size(), 3u);
  for (size_t t = 0; t < 3; ++t) {
    const auto &a = read->steps[t], &b = written.steps[t];
    EXPECT_EQ(a.commanded, b.commanded);
    EXPECT_EQ(a.sent, b.sent);
    EXPECT_EQ(a.measured, b.measured);
    EXPECT_EQ(a.proprioception, b.proprioception);
    EXPECT_EQ(a.before.q, b.before.q);
    EXPECT_EQ(a.before.dq, b.before.dq);
    EXPECT_EQ(a.before.gripper, b.before.gripper);
    EXPECT_EQ(a.before.tool.p_base_tool, b.before.tool.p_base_tool);
    EXPECT_EQ(a.before.tool.q_base_tool.coeffs(), b.before.tool.q_base_tool.coeffs());
    EXPECT_EQ(a.simulator.state, b.simulator.state);
    EXPECT_EQ(a.simulator.joints, b.simulator.joints);
    EXPECT_EQ(a.simulator.fingers, b.simulator.fingers);
    EXPECT_EQ(a.simulator.ee_pos, b.simulator.ee_pos);
    EXPECT_EQ(a.simulator.ee_ori, b.simulator.ee_ori);
    EXPECT_EQ(a.simulator.ee_quat, b.simulator.ee_quat);
  }
}

TEST(EpisodeRecording, SaysWhichTensorIsWrong) {
  EpisodeRecording recording = Recording(3);
  recording.steps[1].measured[2] = std::numeric_limits<float>::quiet_NaN();
  ASSERT_TRUE(WriteEpisodeRecording(recording, Place("nan")).ok());
  EXPECT_THAT(std::string(ReadEpisodeRecording(Place("nan")).status().message()),
              HasSubstr("measured holds nan, must be numbers up to 1e+30"));
  recording = Recording(3);
  recording.pictures[1].pop_back();
  ASSERT_TRUE(WriteEpisodeRecording(recording, Place("short")).ok());
  EXPECT_THAT(std::string(ReadEpisodeRecording(Place("short")).status().message()),
              HasSubstr("picture.robot0_eye_in_hand does not hold a picture for every step"));
  ASSERT_TRUE(WriteEpisodeRecording(Recording(0), Place("empty")).ok());
  EXPECT_FALSE(ReadEpisodeRecording(Place("empty")).ok());
  SafetensorsWriter other;
  other.AddFloats("commanded", {1, 7}, std::vector<float>(7));
  ASSERT_TRUE(other.Write(Place("other")).ok());
  EXPECT_THAT(std::string(ReadEpisodeRecording(Place("other")).status().message()),
              HasSubstr("is no recorded episode"));
}

// Every number of the header and every byte: read or refused, never beyond what is there.
TEST(EpisodeRecording, BearsEveryChangedByte) {
  ASSERT_TRUE(WriteEpisodeRecording(Recording(2), Place("fuzz")).ok());
  const std::string whole = *ReadFile(Place("fuzz"));
  RandomStream random(StreamKey("recording fuzz"));
  int refused = 0;
  for (int i = 0; i < 3000; ++i) {
    std::string changed = whole;
    const int at = random.UniformInt(static_cast<int>(whole.size()));
    changed[at] = static_cast<char>(random.UniformInt(256));
    ASSERT_TRUE(WriteFileAtomically(Place("fuzzed"), changed).ok());
    const auto read = ReadEpisodeRecording(Place("fuzzed"));
    refused += !read.ok();
    if (read.ok()) {
      EXPECT_EQ(read->steps.size(), 2u);
      for (const auto& pictures : read->pictures) EXPECT_EQ(pictures.size(), 2u);
    }
  }
  EXPECT_GT(refused, 100);
}

}  // namespace
}  // namespace robostress
