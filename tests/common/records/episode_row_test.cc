#include "common/records/episode_row.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>
#include <limits>
#include <vector>

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

EpisodeIdentity Identity() {
  return {.suite = "tabletop_goal",
          .scenario = "heavy_payload",
          .policy = "nano",
          .method = "ours",
          .severity = 5,
          .seed = 3,
          .task = 7,
          .episode = 2,
          .initial_state = 42};
}

// The text of files that are there already: keys sorted, absent measures null, lag left out.
TEST(EpisodeRow, IsWrittenAsItAlwaysWas) {
  EpisodeRow row;
  row.success = true;
  row.steps = 187;
  row.chunks = 38;
  row.updates = 4;
  row.adapter_distance = 0.125;
  row.residual = 0.25;
  row.eta_sq = 1.5;
  row.a_sq = std::numeric_limits<double>::quiet_NaN();
  EXPECT_EQ(EpisodeLine(Identity(), row),
            R"({"a_sq":null,"adapter_distance":0.125,"chunks":38,"clipped_share":null,"episode":2,)"
            R"("eta_sq":1.5,"initial_state":42,"intent":null,"intent_a_sq":null,)"
            R"("intent_eta_sq":null,"intent_tracking":null,"intent_tracking_eta_sq":null,)"
            R"("mean_abs_action":null,"method":"ours","policy":"nano","residual":0.25,)"
            R"("residual_tracking":null,"scenario":"heavy_payload","seed":3,"severity":5,)"
            R"("steps":187,"success":true,"suite":"tabletop_goal","task":7,)"
            R"("tracking_eta_sq":null,"updates":4})");
}

TEST(EpisodeRow, EveryMeasureComesBack) {
  EpisodeRow row;
  row.success = true;
  row.steps = 1;
  row.chunks = 2;
  row.updates = 3;
  double value = 0.1;
  const auto fields = [](EpisodeRow& r) {
    return std::vector<std::optional<double>*>{&r.adapter_distance,
                                               &r.residual,
                                               &r.eta_sq,
                                               &r.a_sq,
                                               &r.residual_tracking,
                                               &r.tracking_eta_sq,
                                               &r.intent,
                                               &r.intent_tracking,
                                               &r.intent_eta_sq,
                                               &r.intent_tracking_eta_sq,
                                               &r.intent_a_sq,
                                               &r.mean_abs_action,
                                               &r.clipped_share,
                                               &r.lag_residual,
                                               &r.lag_eta_sq,
                                               &r.seconds};
  };
  for (std::optional<double>* field : fields(row)) *field = value += 0.01;
  row.measured_steps = 40;
  row.masked_steps = 2;
  row.power_cycles = 1;
  row.state = "FAULT";
  row.cause = "pressing";
  row.instruction = "open the \"top\" drawer";
  const std::string line = EpisodeLine(Identity(), row);
  EpisodeRow read = ParseEpisode("f:1", line).value();
  EXPECT_EQ(read.task, 7);
  EXPECT_EQ(read.episode, 2);
  EXPECT_EQ(read.initial_state, 42);
  EXPECT_EQ(read.updates, 3);
  EXPECT_EQ(read.record, line);
  const auto wanted = fields(row), got = fields(read);
  for (size_t i = 0; i < wanted.size(); ++i) EXPECT_EQ(*got[i], *wanted[i]) << i;
  EXPECT_EQ(EpisodeLine(Identity(), read), line);
}

TEST(EpisodeRow, BelongsToItsIdentityAlone) {
  const std::string line = EpisodeLine(Identity(), {});
  EXPECT_TRUE(IsRowOf(Identity(), line));
  for (const auto& change : std::vector<std::function<void(EpisodeIdentity&)>>{
           [](auto& i) { i.suite = "tabletop_long"; }, [](auto& i) { i.scenario = "clean"; },
           [](auto& i) { i.policy = "x"; }, [](auto& i) { i.method = "base"; },
           [](auto& i) { i.severity = 4; }, [](auto& i) { i.seed = 4; },
           [](auto& i) { i.task = 6; }, [](auto& i) { i.episode = 3; },
           [](auto& i) { i.initial_state = 43; }}) {
    EpisodeIdentity other = Identity();
    change(other);
    EXPECT_FALSE(IsRowOf(other, line));
  }
  EXPECT_FALSE(IsRowOf(Identity(), line.substr(0, 40)));
  EXPECT_FALSE(IsRowOf(Identity(), "[]"));
}

TEST(EpisodeRow, WrongFieldsAreNamed) {
  const std::string good = EpisodeLine(Identity(), {});
  const auto with = [&](const std::string& from, const std::string& to) {
    std::string line = good;
    line.replace(line.find(from), from.size(), to);
    return std::string(ParseEpisode("episodes.jsonl:7", line).status().message());
  };
  EXPECT_THAT(with("\"success\":false", "\"success\":\"yes\""),
              AllOf(HasSubstr("episodes.jsonl:7: field success is \"yes\""),
                    HasSubstr("must be true or false")));
  EXPECT_THAT(with("\"steps\":0", "\"steps\":1.5"), HasSubstr("must be an integer"));
  EXPECT_THAT(with("\"steps\":0", "\"steps\":4294967297"), HasSubstr("must be an integer"));
  EXPECT_THAT(with("\"steps\":0", "\"steps\":-9223372036854775808"), HasSubstr("an integer"));
  EXPECT_THAT(with("\"residual\":null", "\"residual\":\"0.3\""), HasSubstr("must be a number"));
  EXPECT_THAT(with("\"chunks\":0,", ""), HasSubstr("field chunks is missing"));
  EXPECT_THAT(with("{", "["), HasSubstr("not a JSON object"));
  EXPECT_THAT(with("\"steps\":0", "\"steps\":-64"),
              HasSubstr(":7: steps is -64, must be 0 or more"));
  EXPECT_THAT(with("\"residual\":null", "\"residual\":-9.5"), HasSubstr("residual is -9.5"));
  EXPECT_THAT(with("\"clipped_share\":null", "\"clipped_share\":55"),
              HasSubstr("clipped_share is 55, must be 0 to 1"));
}

TEST(TimingRow, ComesBackAndForgivesStrangers) {
  const std::string line = TimingLine({7, 2, 1.5, 0.5, 0.25, 0.125, 0.0625});
  EXPECT_EQ(line,
            R"({"episode":2,"feedback_s":0.0625,"observe_s":0.125,"predict_s":0.5,"step_s":0.25,)"
            R"("task":7,"wall_s":1.5})");
  const auto row = ParseTiming(line);
  ASSERT_TRUE(row.has_value());
  EXPECT_EQ(row->task, 7);
  EXPECT_EQ(row->step_s, 0.25);
  EXPECT_FALSE(ParseTiming("{}").has_value());
  EXPECT_FALSE(ParseTiming("7").has_value());
  EXPECT_FALSE(ParseTiming(line.substr(0, 30)).has_value());
}

}  // namespace
}  // namespace robostress
