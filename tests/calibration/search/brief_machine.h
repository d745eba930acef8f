#pragma once

#include <gtest/gtest.h>

#include <filesystem>
#include <string>
#include <utility>

#include "tests/calibration/generator/generated_rig.h"
#include "tests/calibration/search/rig_problem.h"

namespace robostress::calibration {

// A generated machine with the shortest logs.
class BriefMachine : public testing::Test {
 protected:
  BriefMachine(generator::Family family, uint64_t seed) : family_(family), seed_(seed) {}
  void SetUp() override {
    generator::RigOptions options;
    options.family = family_;
    options.richness = generator::Richness::kBrief;
    options.seed = seed_;
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

  const generator::Family family_;
  const uint64_t seed_;
  std::string folder_;
  LoadedRig rig_;
};

class BriefServo : public BriefMachine {
 protected:
  BriefServo() : BriefMachine(generator::Family::kServo, 12) {}
};

}  // namespace robostress::calibration
