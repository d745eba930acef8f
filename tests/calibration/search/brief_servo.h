#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <utility>

#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {

// A generated servo with the shortest logs.
class BriefServo : public testing::Test {
 protected:
  void SetUp() override {
    generator::RigOptions options;
    options.family = generator::Family::kServo;
    options.richness = generator::Richness::kBrief;
    options.seed = 12;
    const auto machine = generator::GenerateRig(options);
    ASSERT_TRUE(machine.ok()) << machine.status();
    const testing::TestInfo& test = *testing::UnitTest::GetInstance()->current_test_info();
    folder_ = testing::TempDir() + "/" + test.test_suite_name() + "." + test.name();
    ASSERT_TRUE(WriteGeneratedRig(*machine, options, folder_).ok());
    auto rig = LoadRig(folder_ + "/rig.yaml");
    ASSERT_TRUE(rig.ok()) << rig.status();
    rig_ = *std::move(rig);
  }
  void TearDown() override { std::filesystem::remove_all(folder_); }

  std::string folder_;
  LoadedRig rig_;
};

}  // namespace robostress::calibration
