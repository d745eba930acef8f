// A short version of grid_kills with stand-ins; the long one is run by hand
// (docs/results/sweeps-at-scale.md).

#include "tests/eval/launch/random_kills.h"

#include "gtest/gtest.h"
#include "tests/eval/synthetic_run.h"

namespace robostress {
namespace {

TEST(RandomKills, TheSameCommandAgainGivesTheSameTable) {
  KillPlan plan;
  plan.sweep = std::string(BIN_DIR) + "/robostress-sweep";
  plan.programs = FAKE_PROGRAMS;
  plan.folder = TestFolder();
  plan.kills = 12;
  plan.seed = 3;
  plan.arguments = {"--suites",
                    "tabletop_goal",
                    "--tasks",
                    "2",
                    "--episodes",
                    "4",
                    "--scenarios",
                    "clean,heavy_payload",
                    "--methods",
                    "base,ours,null",
                    "--workers",
                    "2",
                    "--quiet",
                    "--split-episodes",
                    "3"};
  const absl::StatusOr<KillResult> result = KillAtRandom(plan);
  ASSERT_TRUE(result.ok()) << result.status();
  EXPECT_GE(result->Kills(), 12);
  EXPECT_GE(result->runs, 1);
}

}  // namespace
}  // namespace robostress
