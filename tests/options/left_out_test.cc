// A build without some of its parts names the option wherever one of them is asked for.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "absl/strings/match.h"
#include "absl/strings/str_cat.h"
#include "absl/strings/str_split.h"
#include "eval/launch/cluster_launchers.h"
#include "eval/plan/build_info.h"
#include "tests/run_program.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;
using ::testing::Not;

// A command that is there only with the option.
const std::map<std::string, std::string> kCommandOf = {{"ROBOSTRESS_TORCH", "serve"},
                                                       {"ROBOSTRESS_MUJOCO", "calibrate"},
                                                       {"ROBOSTRESS_SUITES", "worker"},
                                                       {"ROBOSTRESS_LIBERO", "replay"},
                                                       {"ROBOSTRESS_OPENPI", "tokenize"},
                                                       {"ROBOSTRESS_CLUSTER", "grid-job"},
                                                       {"ROBOSTRESS_ROBOT_CLIENT", "piper-study"}};

std::vector<std::string> LeftOut() { return absl::StrSplit(kLeftOut, ' ', absl::SkipEmpty()); }

TEST(LeftOut, CommandsAndHelpNameTheOption) {
  const std::string program = absl::StrCat(BIN_DIR, "/robostress");
  const std::string help = RunProgram(program, "help").first;
  ASSERT_FALSE(LeftOut().empty());
  for (const std::string& option : LeftOut()) {
    const std::string& command = kCommandOf.at(option);
    EXPECT_THAT(help, ::testing::ContainsRegex(
                          absl::StrCat("\n  ", command, " .*\\(not in this build: ROBOSTRESS_")));
    const auto [output, code] = RunProgram(program, command);
    EXPECT_EQ(code, 2) << output;
    EXPECT_THAT(output, HasSubstr("=OFF")) << command;
    if (LeftOut().size() == 1) {
      EXPECT_THAT(output, HasSubstr(absl::StrCat(option, "=OFF")));
    }
  }
}

TEST(LeftOut, LaunchersNameTheOption) {
  if (!absl::StrContains(kLeftOut, "ROBOSTRESS_CLUSTER")) GTEST_SKIP() << "this build has them";
  EXPECT_EQ(LauncherNames(), std::vector<std::string>{"local"});
  for (const char* name : {"slurm", "kubernetes"})
    EXPECT_THAT(MakeLauncher(name).status().message(), HasSubstr("ROBOSTRESS_CLUSTER=OFF"));
  const std::string help = RunProgram(absl::StrCat(BIN_DIR, "/robostress-sweep"), "--help").first;
  EXPECT_THAT(help, HasSubstr("--launcher"));
  for (const char* flag : {"--slurm-server", "--image", "--servers", "--wait"})
    EXPECT_THAT(help, Not(HasSubstr(flag)));
  const auto jobs = JobsInQueue(RunDirectory("runs/somewhere"));
  EXPECT_EQ(jobs.status().code(), absl::StatusCode::kUnimplemented);
  EXPECT_THAT(jobs.status().message(), HasSubstr("runs/somewhere/submissions"));
}

}  // namespace
}  // namespace robostress
