#include "common/rollout/spec_checks.h"

#include "tests/common/rpc/wire_samples.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

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

}  // namespace
}  // namespace robostress
