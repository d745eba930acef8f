// `robostress residual` through its program, with stand-ins for worker and server.

#include <sys/wait.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <string>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

class ResidualProgram : public ::testing::Test {
 protected:
  void SetUp() override { folder_ = TestFolder(); }

  // Runs a program with stand-ins on a small grid; returns its exit code, output in output().
  int Run(const std::string& program, const std::string& arguments) {
    const std::string command = absl::StrCat(
        "ROBOSTRESS_BIN='", FAKE_PROGRAMS, "' '", BIN_DIR, "/robostress-", program,
        "' --suite tabletop_goal --scenario clean,heavy_payload --policy expert --methods base "
        "--tasks 2 --episodes 3 ",
        arguments, " > '", folder_, "/output.txt' 2>&1");
    const int status = std::system(command.c_str());
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
  }
  std::string output() const { return Read("output.txt"); }
  std::string Read(const std::string& file) const { return *ReadFile(folder_ + "/" + file); }
  std::string Out(const std::string& name) const {
    return absl::StrCat("--out '", folder_, "/", name, "' ");
  }

  std::string folder_;
};

TEST_F(ResidualProgram, TablesBothGoalReferencesWithTheirLag) {
  ASSERT_EQ(Run("residual", Out("run")), 0) << output();
  EXPECT_THAT(output(), HasSubstr("goal reference achieved, policy expert, method base"));
  EXPECT_THAT(output(), HasSubstr("goal reference desired, policy expert, method base"));
  EXPECT_THAT(output(), HasSubstr("48.6")) << "the paper's value for Heavy Payload";
  // The stand-in's lag is its residual in Clean and half of it elsewhere.
  EXPECT_THAT(Read("run/residual.md"), HasSubstr("| +0.0 [+0.0, +0.0] | 100.0 [100.0, 100.0] |"));
  EXPECT_THAT(Read("run/residual.md"), HasSubstr(" | 50.0 [50.0, 50.0] | "));
  const std::string csv = Read("run/residual.csv");
  EXPECT_EQ(std::count(csv.begin(), csv.end(), '\n'), 1 + 2 * 2 * 6);
  EXPECT_THAT(csv.substr(0, csv.find('\n')),
              ::testing::AllOf(HasSubstr("goal_reference"), HasSubstr("lag_residual")));
}

TEST_F(ResidualProgram, SameBytesForOneWorkerAndTwoAndNothingIsRepeated) {
  ASSERT_EQ(Run("residual", Out("one") + "--workers 1"), 0) << output();
  ASSERT_EQ(Run("residual", Out("two") + "--workers 2"), 0) << output();
  EXPECT_EQ(Read("one/residual.csv"), Read("two/residual.csv"));
  EXPECT_EQ(Read("one/residual.md"), Read("two/residual.md"));
  ASSERT_EQ(Run("residual", Out("one")), 0) << output();
  EXPECT_THAT(output(), HasSubstr("2 of 2 units were already done"));
  EXPECT_EQ(Read("one/residual.md"), Read("two/residual.md"));
}

TEST_F(ResidualProgram, RunOfASweepIsRefusedBecauseItHasNoLag) {
  ASSERT_EQ(Run("sweep", Out("run/achieved") + "--set sim.goal_reference=achieved"), 0) << output();
  EXPECT_EQ(Run("residual", Out("run") + "--goal-reference achieved"), 1);
  EXPECT_THAT(output(), HasSubstr("field lag_residual is missing"));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/run/residual.csv"));
}

TEST_F(ResidualProgram, WrongCommandsEndWithCodeTwoAndWriteNothing) {
  const std::pair<const char*, const char*> cases[] = {
      {"--goal-references wished", "'wished'"},
      {"--goal-references achieved,achieved", "given twice"},
      {"--set sim.goal_reference=desired", "use --goal-references"},
      {"--first-initial-state 50", "first initial state 50"},
  };
  for (const auto& [arguments, message] : cases) {
    EXPECT_EQ(Run("residual", Out("run") + arguments), 2) << output();
    EXPECT_THAT(output(), HasSubstr(message));
  }
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/run"));
}

TEST_F(ResidualProgram, DryRunListsTheUnitsOfBothReferences) {
  EXPECT_EQ(Run("residual", Out("run") + "--dry-run"), 0);
  EXPECT_THAT(output(), HasSubstr("/run/desired/tabletop_goal-heavy_payload-L5-expert-base-s0"));
  EXPECT_FALSE(std::filesystem::exists(folder_ + "/run"));
}

}  // namespace
}  // namespace robostress
