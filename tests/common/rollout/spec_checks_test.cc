#include "common/rollout/spec_checks.h"

#include <cmath>

#include "common/rollout/field_checks.h"
#include "tests/common/rpc/wire_samples.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

TEST(FieldChecks, UseUtf8AsItIsDefined) {
  for (const char* text : {"", "plain", "caf\xc3\xa9", "\xe2\x82\xac", "\xf0\x9f\xa4\x96",
                           "\xed\x9f\xbf", "\xf4\x8f\xbf\xbf"}) {
    EXPECT_TRUE(CheckUtf8("prompt", text).ok()) << text;
  }
  // Alone, cut off, longer than need be, a surrogate, beyond the last character.
  for (const char* text :
       {"\x80", "caf\xe9", "\xc3", "\xe2\x82", "\xf0\x9f\xa4", "\xc0\xaf", "\xe0\x80\xaf",
        "\xf0\x80\x80\xaf", "\xed\xa0\x80", "\xf4\x90\x80\x80", "\xff"}) {
    EXPECT_FALSE(CheckUtf8("prompt", text).ok()) << text;
  }
  EXPECT_THAT(std::string(CheckUtf8("prompt", "a caf\xe9.").message()),
              HasSubstr("prompt: byte 6 of 7 (233) is not UTF-8; send the text in UTF-8"));
}

TEST(SpecChecks, NameWhatThePolicyWants) {
  PolicySpec spec;
  spec.name = "fake";
  spec.state_dim = 2;
  spec.action_dim = 3;
  spec.horizon = 4;
  Observation observation = MakeObservation();
  EXPECT_THAT(std::string(CheckObservation(observation, spec).message()),
              HasSubstr("has the views [agentview], policy 'fake' wants []"));
  spec.cameras = {"agentview"};
  EXPECT_TRUE(CheckObservation(observation, spec).ok());  // 2 x 1 px: the policy's own affair
  observation.views[0].image.width = spec.max_view_side + 1;
  EXPECT_THAT(
      std::string(CheckObservation(observation, spec).message()),
      HasSubstr("view 'agentview' is 1281 x 1 px, at most 1280 a side; policy 'fake' computes "
                "with 224 x 224"));
  observation.views[0].image.width = 2;
  spec.state_dim = 8;
  EXPECT_THAT(std::string(CheckObservation(observation, spec).message()),
              HasSubstr("proprioception has 2 values, policy 'fake' wants 8"));

  ExecutedChunk chunk = MakeChunk(true);
  EXPECT_TRUE(CheckExecutedChunk(chunk, spec).ok());
  chunk.first_step = 3;
  EXPECT_THAT(std::string(CheckExecutedChunk(chunk, spec).message()),
              HasSubstr("covers steps 3 to 4, policy 'fake' predicts 4"));
  chunk.first_step = 0;
  chunk.steps[1].base_command.resize(0);
  EXPECT_THAT(std::string(CheckExecutedChunk(chunk, spec).message()),
              HasSubstr("step 1: base_command has 0 values, must have 3"));
  chunk.steps.clear();
  EXPECT_THAT(std::string(CheckExecutedChunk(chunk, spec).message()), HasSubstr("has no steps"));
}

TEST(SpecChecks, NameTheFieldOfASessionThatIsWrong) {
  const auto refusal = [](auto damage) {
    RequestedSession spec = MakeSession();
    damage(spec);
    return std::string(CheckSessionSpec(spec).message());
  };
  EXPECT_EQ(refusal([](RequestedSession&) {}), "");
  EXPECT_THAT(refusal([](RequestedSession& s) { s.suite = ""; }), HasSubstr("spec.suite is empty"));
  EXPECT_THAT(refusal([](RequestedSession& s) { s.scenario = "a b"; }),
              HasSubstr("spec.scenario contains byte 32"));
  EXPECT_THAT(refusal([](RequestedSession& s) { s.severity = 6; }),
              HasSubstr("spec.severity is 6, must be 1 to 5"));
  EXPECT_THAT(refusal([](RequestedSession& s) { s.rotation_scale = 101; }),
              HasSubstr("spec.rotation_scale is 101, must be 1e-6..100"));
  for (double SessionSetting::*scale :
       {&SessionSetting::control_period_s, &SessionSetting::translation_scale,
        &SessionSetting::rotation_scale}) {
    for (const double wrong : {0.0, -1.0, 9e-7, std::nan("")}) {
      EXPECT_THAT(refusal([&](RequestedSession& s) { s.*scale = wrong; }),
                  HasSubstr("must be 1e-6..100"))
          << wrong;
    }
  }
}

TEST(SpecChecks, NameWhatIsWrongWithRunningRows) {
  PolicySpec spec;
  spec.name = "fake";
  spec.action_dim = 3;
  spec.horizon = 4;
  RunningRows running;
  running.actions = Eigen::MatrixXf::Constant(2, 3, 0.5f);
  running.held = 2;
  EXPECT_TRUE(absl::IsUnimplemented(CheckRunningRows(running, spec)));
  spec.inpaints = true;
  EXPECT_TRUE(CheckRunningRows(running, spec).ok());
  const auto refusal = [&](auto damage) {
    RunningRows wrong = running;
    damage(wrong);
    const absl::Status status = CheckRunningRows(wrong, spec);
    EXPECT_TRUE(absl::IsInvalidArgument(status));
    return std::string(status.message());
  };
  EXPECT_EQ(refusal([](RunningRows& r) { r.actions.resize(5, 3); }),
            "running.actions is 5 x 3, policy 'fake' takes 1 to 4 rows x 3");
  EXPECT_EQ(refusal([](RunningRows& r) { r.actions.resize(0, 3); }),
            "running.actions is 0 x 3, policy 'fake' takes 1 to 4 rows x 3");
  EXPECT_EQ(refusal([](RunningRows& r) { r.actions.setZero(2, 2); }),
            "running.actions is 2 x 2, policy 'fake' takes 1 to 4 rows x 3");
  EXPECT_EQ(refusal([](RunningRows& r) { r.held = 3; }),
            "running.held is 3, must be 0 to the 2 rows of running.actions");
  EXPECT_EQ(refusal([](RunningRows& r) { r.held = -1; }),
            "running.held is -1, must be 0 to the 2 rows of running.actions");
  EXPECT_EQ(refusal([](RunningRows& r) { r.actions(1, 2) = -1001; }),
            "running.actions[1,2] is -1001, must be within +-1000");
  EXPECT_EQ(refusal([](RunningRows& r) { r.actions(0, 1) = std::nanf(""); }),
            "running.actions[0,1] is nan, must be within +-1000");
}

}  // namespace
}  // namespace robostress
