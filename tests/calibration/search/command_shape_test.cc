#include "calibration/search/command_shape.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <filesystem>

#include "common/random.h"
#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {
namespace {

// A generated servo with nothing hidden, whose commands are logged as `hardship` says.
class CommandShape : public testing::Test {
 protected:
  void Draw(generator::Hardship hardship) {
    generator::RigOptions options;
    options.family = generator::Family::kServo;
    options.richness = generator::Richness::kBrief;
    options.hardship = hardship;
    options.seed = 5;
    const auto machine = generator::GenerateRig(options);
    ASSERT_TRUE(machine.ok()) << machine.status();
    folder_ = testing::TempDir() + "/command_shape";
    ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder_).ok());
    auto rig = LoadRig(folder_ + "/rig.yaml");
    ASSERT_TRUE(rig.ok()) << rig.status();
    rig_ = *std::move(rig);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }
  // So that lines and steps predict as well, but for the time by which lines lead.
  void Blur(double noise) {
    RandomStream random(StreamKey("blur"));
    for (MeasuredLog& log : rig_.logs)
      for (double& q : log.joints[0].q) q += noise * random.Normal();
  }
  bool Steps() {
    const absl::Status status = ChooseCommandShapes(rig_.rig, *rig_.plant, rig_.logs);
    EXPECT_TRUE(status.ok()) << status;
    const JointRecord& record = rig_.logs.front().joints[0];
    return record.step_rows > 0 && record.command == record.stepped_command;
  }

  std::string folder_;
  LoadedRig rig_;
};

TEST_F(CommandShape, IsOfStepsWhereARecorderDrewLines) {
  Draw(generator::Hardship::kRamped);
  EXPECT_EQ(rig_.logs.front().joints[0].step_rows, 4);
  EXPECT_TRUE(Steps());
}

TEST_F(CommandShape, IsOfStepsInLogsThatBendTooRarelyToTell) {
  Draw(generator::Hardship::kRamped);
  MeasuredLog& rare = rig_.logs.back();
  rare.joints[0].step_rows = 0;
  rare.joints[0].stepped_command.clear();
  EXPECT_TRUE(Steps());
  EXPECT_EQ(rig_.logs.back().joints[0].step_rows, 4);
  EXPECT_EQ(rig_.logs.back().joints[0].command, rig_.logs.back().joints[0].stepped_command);
}

TEST_F(CommandShape, IsOfStepsRatherThanOfADelayOfHalfAStep) {
  Draw(generator::Hardship::kRamped);
  Blur(0.02);
  EXPECT_TRUE(Steps());
}

TEST_F(CommandShape, IsOfLinesWhereTheServoSawThem) {
  Draw(generator::Hardship::kRamped);
  // The machine follows the lines: its readings come half a step earlier than those of steps.
  for (MeasuredLog& log : rig_.logs) {
    JointRecord& record = log.joints[0];
    std::rotate(record.q.begin(), record.q.begin() + 2, record.q.end());
    std::rotate(record.q_smooth.begin(), record.q_smooth.begin() + 2, record.q_smooth.end());
    std::rotate(record.dq.begin(), record.dq.begin() + 2, record.dq.end());
  }
  Blur(0.02);
  EXPECT_FALSE(Steps());
}

}  // namespace
}  // namespace robostress::calibration
