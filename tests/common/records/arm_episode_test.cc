#include "common/records/arm_episode.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace robostress {
namespace {

using ::testing::HasSubstr;

TEST(ArmEpisode, LeavesOutWhatIsNotKnown) {
  ArmEpisode row;
  row.episode = 3;
  row.seconds = 1.5;
  row.state = "ENABLED";
  EXPECT_EQ(ArmEpisodeLine(row),
            R"({"episode":3,"success":null,"seconds":1.5,"feedback_chunks":0,"steps":0,)"
            R"("steps_masked":0,"residual":0.0,"adapter_version":0,"state":"ENABLED"})");
}

TEST(ArmEpisode, EveryFieldComesBack) {
  ArmEpisode row;
  row.task = 1;
  row.episode = 2;
  row.success = false;
  row.seconds = 3.5;
  row.predictions = 4;
  row.failed_predictions = 5;
  row.failed_feedback = 10;
  row.feedback_chunks = 6;
  row.steps = 7;
  row.steps_masked = 8;
  row.residual = 0.5;
  row.eta_sq = 0.25;
  row.displacement_sq = 0.75;
  row.adapter_version = uint64_t{1} << 63;
  row.sessions = 9;
  row.state = "FAULT";
  row.cause = "pressing";
  const std::string line = ArmEpisodeLine(row);
  const ArmEpisode read = ParseArmEpisode("f:1", line).value();
  EXPECT_EQ(ArmEpisodeLine(read), line);
  EXPECT_EQ(read.success, false);
  EXPECT_EQ(read.cause, row.cause);
  EXPECT_EQ(read.failed_feedback, 10u);
  EXPECT_EQ(read.adapter_version, uint64_t{1} << 63);
}

TEST(ArmEpisode, WrongFieldsAreNamed) {
  EXPECT_THAT(std::string(ParseArmEpisode("e.jsonl:4", R"({"episode":-1})").status().message()),
              HasSubstr("e.jsonl:4: field seconds is missing"));
  EXPECT_THAT(std::string(ParseArmEpisode("e.jsonl:4", "x").status().message()),
              HasSubstr("e.jsonl:4: not a JSON object"));
}

}  // namespace
}  // namespace robostress
