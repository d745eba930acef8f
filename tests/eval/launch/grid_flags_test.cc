#include "eval/launch/grid_flags.h"

#include <string>
#include <vector>

#include "common/run_main.h"
#include "common/suites.h"
#include "gmock/gmock.h"
#include "gtest/gtest.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// The grid that `robostress sweep` makes of these words, before it is resolved.
absl::StatusOr<SweepGrid> GridOf(std::vector<std::string> words, SweepGrid grid = {}) {
  cli::App app("test", "sweep");
  GridFlags flags;
  LaunchOptions launch;
  DeclareLaunchFlags(app, launch);
  DeclareGridFlags(app, flags);
  words.insert(words.begin(), "sweep");
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  if (const auto code = ParseCommandLine(app, static_cast<int>(argv.size()), argv.data()))
    return absl::InvalidArgumentError("the command line is wrong");
  const absl::Status status = ApplyGridFlags(app, flags, grid);
  if (!status.ok()) return status;
  return grid;
}

TEST(GridFlagsTest, ProtocolOpenpiIsItsExample) {
  const absl::StatusOr<SweepGrid> grid =
      GridOf({"--policy-url", "ws://host:8000", "--protocol", "openpi"});
  ASSERT_TRUE(grid.ok()) << grid.status();
  EXPECT_THAT(grid->suites,
              ElementsAre("libero_spatial", "libero_object", "libero_goal", "libero_10"));
  EXPECT_EQ(grid->episodes, 50);
  EXPECT_EQ(grid->first_initial_state, 0);
  EXPECT_THAT(grid->seeds, ElementsAre(7));
  EXPECT_EQ(grid->libero_fixtures, "numpy:7");
  EXPECT_EQ(grid->remote.execute_steps, 5);
  EXPECT_EQ(grid->remote.image_size, 224);
  SweepGrid resolved = *grid;
  resolved.libero_root = resolved.robosuite_root = "somewhere";
  const auto checked = ResolveGrid(resolved, PolicyHome::kElsewhere);
  ASSERT_TRUE(checked.ok()) << checked.status();
  const auto units = ExpandUnits(*checked);
  ASSERT_TRUE(units.ok()) << units.status();
  for (const PlannedUnit& unit : *units) {
    const std::string& suite = unit.config.suite;
    EXPECT_EQ(unit.config.horizon, suite == "libero_spatial"  ? 220
                                   : suite == "libero_object" ? 280
                                   : suite == "libero_goal"   ? 300
                                                              : 520);
    EXPECT_EQ(unit.config.sim.settle_steps, 10);
    EXPECT_TRUE(unit.config.sim.LateObservation());
  }
}

TEST(GridFlagsTest, ASeedThatDoesNotFitIsRefused) {
  EXPECT_FALSE(GridOf({"--seeds", "0,99999999999999999999"}).ok());
  EXPECT_FALSE(GridOf({"--seeds=-9223372036854775809"}).ok());
  const absl::StatusOr<SweepGrid> largest = GridOf({"--seeds", "0,9223372036854775807"});
  ASSERT_TRUE(largest.ok()) << largest.status();
  EXPECT_THAT(largest->seeds, ElementsAre(0, 9223372036854775807));
}

TEST(GridFlagsTest, ProtocolLerobotIsItsEvaluation) {
  const absl::StatusOr<SweepGrid> grid =
      GridOf({"--policy-url", "ws://host:8000", "--protocol", "lerobot", "--dialect", "lerobot"});
  ASSERT_TRUE(grid.ok()) << grid.status();
  EXPECT_EQ(grid->episodes, 10);
  EXPECT_THAT(grid->seeds, ElementsAre(1000));
  EXPECT_EQ(grid->libero_fixtures, "numpy-each:1000");
  EXPECT_EQ(grid->remote.execute_steps, 10);
  EXPECT_EQ(grid->remote.image_size, 256);
  EXPECT_EQ(grid->step_limits, "lerobot");
}

TEST(GridFlagsTest, OtherFlagsGoBeforeAProtocol) {
  const absl::StatusOr<SweepGrid> grid =
      GridOf({"--protocol", "openpi", "--suites", "libero_goal", "--episodes", "3", "--seeds",
              "1,2", "--libero-fixtures", "centred", "--set", "sim.settle_steps=4",
              "--first-initial-state", "40"});
  ASSERT_TRUE(grid.ok()) << grid.status();
  EXPECT_THAT(grid->suites, ElementsAre("libero_goal"));
  EXPECT_EQ(grid->episodes, 3);
  EXPECT_EQ(grid->first_initial_state, 40);
  EXPECT_THAT(grid->seeds, ElementsAre(1, 2));
  EXPECT_EQ(grid->libero_fixtures, "centred");
  EXPECT_EQ(grid->overrides.back(), "sim.settle_steps=4");
  EXPECT_EQ(grid->step_limits, "openpi");
}

TEST(GridFlagsTest, AProtocolIsRefusedWhereItHasNoConstants) {
  EXPECT_THAT(std::string(GridOf({"--protocol", "openvla"}).status().message()),
              HasSubstr("protocol 'openvla' is unknown; known: openpi, lerobot"));
  const absl::StatusOr<SweepGrid> grid =
      GridOf({"--protocol", "openpi", "--suites", "tabletop_goal"});
  ASSERT_TRUE(grid.ok()) << grid.status();
  EXPECT_THAT(std::string(ResolveGrid(*grid).status().message()),
              AllOf(HasSubstr("protocol openpi has no step limit for suite tabletop_goal"),
                    HasSubstr("it has libero_spatial, libero_object, libero_goal, libero_10")));
}

TEST(GridFlagsTest, WithoutAProtocolNothingOfItIsSet) {
  const absl::StatusOr<SweepGrid> grid = GridOf({"--suites", "libero_goal"});
  ASSERT_TRUE(grid.ok()) << grid.status();
  EXPECT_EQ(grid->step_limits, "");
  EXPECT_EQ(grid->episodes, 20);
  EXPECT_THAT(grid->overrides, IsEmpty());
}

TEST(GridFlagsTest, LateSaysWhatTheArmDoesWhereAnswersTakeTime) {
  const absl::StatusOr<SweepGrid> grid = GridOf({"--latency-ms", "150", "--late", "waiting"});
  ASSERT_TRUE(grid.ok()) << grid.status();
  EXPECT_EQ(grid->latency.ms, 150);
  EXPECT_EQ(grid->latency.mode, LateChunks::kWaiting);
  EXPECT_FALSE(GridOf({})->latency.used());
  EXPECT_THAT(std::string(GridOf({"--late", "rtc"}).status().message()),
              HasSubstr("give --latency-ms N"));
  EXPECT_TRUE(GridOf({"--late", "rtc", "--set", "latency.ms=50"}).ok());
}

}  // namespace
}  // namespace robostress
