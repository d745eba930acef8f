// The whole circle as one command: errors hidden in the simulated arm are named at their joints,
// and simulations with them are nearer to the recording than simulations without.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "nlohmann/json.hpp"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
namespace fs = std::filesystem;

struct CloseLoopTest : public testing::Test {
  CloseLoopTest()
      : root((fs::path(testing::TempDir()) / absl::StrCat("close_loop_", getpid())).string()) {
    fs::create_directories(root);
  }
  ~CloseLoopTest() override { fs::remove_all(root); }
  std::string root;
};

TEST_F(CloseLoopTest, FindsWhatWasHiddenAndBringsTheSimulationToTheRecording) {
  const std::string hidden = root + "/worn_elbow.yaml";
  ASSERT_TRUE(WriteFileAtomically(hidden, R"(title: Worn elbow
joints:
  - name: J4
    effects: [{type: deadzone, width: 1.5}]
)")
                  .ok());
  const std::string command = absl::StrCat("--hidden ", hidden, " --out ", root,
                                           "/circle --tasks 1-1 --episodes 3 --rate-hz 125 ",
                                           "--evaluated-episodes 2 --surrogates 99");
  const auto [output, code] = RunProgram(CLOSE_LOOP, command);
  ASSERT_EQ(code, 0) << output;
  const auto text = ReadFile(root + "/circle/summary.json");
  ASSERT_TRUE(text.ok()) << text.status();
  const auto summary = nlohmann::json::parse(*text);
  bool named = false;
  for (const auto& effect : summary["found"]) {
    if (effect["joint"] != "J4" || effect["type"] != "deadzone") continue;
    named = effect["verdict"] == "attributed" || effect["verdict"] == "ambiguous";
    EXPECT_NEAR(effect["parameters"]["width"].get<double>(), 1.5, 0.2);
  }
  EXPECT_TRUE(named) << output;
  const auto& replay = summary["replay"];
  EXPECT_LT(replay["after"]["free_motion"]["joint_rad"].get<double>(),
            0.3 * replay["before"]["free_motion"]["joint_rad"].get<double>())
      << output;
  EXPECT_EQ(summary["success"]["found"]["episodes"], 2);
  EXPECT_EQ(summary["success"]["same_as_hidden"]["found"]["episodes"], 2);
  EXPECT_THAT(output, HasSubstr("outcome as under the hidden"));
  EXPECT_THAT(output, HasSubstr("until first contact"));

  // What is complete is not done again, and another circle does not mix with it.
  const auto again = RunProgram(CLOSE_LOOP, command);
  EXPECT_EQ(again.second, 0) << again.first;
  EXPECT_THAT(again.first, HasSubstr("already done"));
  const auto other = RunProgram(CLOSE_LOOP, command + " --seed 5");
  EXPECT_EQ(other.second, 1);
  EXPECT_THAT(other.first, HasSubstr("other options"));
}

TEST_F(CloseLoopTest, TheControlHidesNothingAndFindsNothing) {
  const auto [output, code] = RunProgram(
      CLOSE_LOOP, absl::StrCat("--hidden clean --out ", root, "/control --tasks 1-1 --episodes 3 ",
                               "--rate-hz 125 --evaluated-episodes 1 --surrogates 99"));
  ASSERT_EQ(code, 0) << output;
  const auto text = ReadFile(root + "/control/summary.json");
  ASSERT_TRUE(text.ok()) << text.status();
  const auto summary = nlohmann::json::parse(*text);
  EXPECT_TRUE(summary["hidden"].empty());
  EXPECT_TRUE(summary["found"].empty()) << output;
  EXPECT_EQ(summary["success"]["same_as_hidden"]["clean"]["same"], 1);
}

TEST_F(CloseLoopTest, SaysWhatIsWrongWithAHiddenScenario) {
  const std::string hidden = root + "/bad.yaml";
  ASSERT_TRUE(WriteFileAtomically(hidden, "joints: [{name: J4, effects: [{type: rust}]}]\n").ok());
  const auto [output, code] =
      RunProgram(CLOSE_LOOP, absl::StrCat("--hidden ", hidden, " --out ", root, "/circle"));
  EXPECT_EQ(code, 2);
  EXPECT_THAT(output, HasSubstr("'rust'"));
}

}  // namespace
}  // namespace robostress
