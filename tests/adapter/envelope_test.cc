#include "adapter/envelope.h"

#include <gtest/gtest.h>

#include "adapter/command_correction.h"
#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "tests/adapter/disturbed_arm.h"

namespace robostress {
namespace {

using Vector6 = NominalArm::Vector6;

Envelope MakeEnvelope(double share) { return Envelope({.share = share}, {}, {}); }

const Vector6 kAhead = 0.5 * Vector6::Unit(0);

TEST(Envelope, TellsAHeldArmFromAWeakOne) {
  for (const double gain : {0.0, 0.15, 0.25, 1.0}) {
    Envelope envelope = MakeEnvelope(0.2);
    DisturbedArm arm(gain, Vector6::Zero());
    envelope.Observe(arm.Execute(kAhead, Vector6::Zero(), 80));
    EXPECT_EQ(envelope.held(), gain < 0.2) << gain;
  }
  Envelope backwards = MakeEnvelope(0.2);
  DisturbedArm pushed(0, -kAhead);
  backwards.Observe(pushed.Execute(kAhead, Vector6::Zero(), 80));
  EXPECT_TRUE(backwards.held()) << "motion the other way is no way";
}

TEST(Envelope, ASmallWayTellsNothing) {
  Envelope envelope = MakeEnvelope(0.2);
  DisturbedArm stuck(0, Vector6::Zero());
  envelope.Observe(stuck.Execute(0.6 * kAhead, Vector6::Zero(), 400));
  EXPECT_FALSE(envelope.held()) << "a joint that sticks under small commands is what is mended";
  EXPECT_TRUE(envelope.held_shortly()) << "there is nothing to learn from it";
  envelope.Observe(stuck.Execute(2 * kAhead, Vector6::Zero(), 3));
  EXPECT_FALSE(envelope.held()) << "pushing harder may move it";
  envelope.Observe(stuck.Execute(2 * kAhead, Vector6::Zero(), 20));
  EXPECT_TRUE(envelope.held()) << "it did not";
}

TEST(Envelope, ForgetsWithinItsMemoryAndWithAnEpisode) {
  Envelope envelope = MakeEnvelope(0.2);
  DisturbedArm held(0, Vector6::Zero());
  envelope.Observe(held.Execute(kAhead, Vector6::Zero(), 80));
  EXPECT_TRUE(envelope.held());
  Envelope still = envelope;
  still.Observe(held.Execute(Vector6::Zero(), Vector6::Zero(), 20));
  EXPECT_FALSE(still.held());
  envelope.StartEpisode();
  EXPECT_FALSE(envelope.held());
}

TEST(Envelope, AMaskedStepSaysNothing) {
  Envelope envelope = MakeEnvelope(0.2);
  DisturbedArm held(0, Vector6::Zero());
  ExecutedChunk chunk = held.Execute(kAhead, Vector6::Zero(), 80);
  chunk.masked.assign(80, true);
  envelope.Observe(chunk);
  EXPECT_FALSE(envelope.held());
}

TEST(Envelope, GoesOnFromItsState) {
  Envelope envelope = MakeEnvelope(0.2), other = MakeEnvelope(0.2);
  DisturbedArm arm(0.3, Vector6::Zero());
  envelope.Observe(arm.Execute(kAhead, Vector6::Zero(), 7));
  ASSERT_TRUE(other.Holds(envelope.State()));
  other.SetState(envelope.State());
  const ExecutedChunk next = arm.Execute(-kAhead, Vector6::Zero(), 9);
  envelope.Observe(next);
  other.Observe(next);
  EXPECT_EQ(envelope.State(), other.State());
  Eigen::VectorXd bad = envelope.State();
  bad[4] = 1e13;
  EXPECT_FALSE(other.Holds(bad));
  EXPECT_FALSE(other.Holds(bad.head(23)));
}

// Chunk by chunk and step by step are the same, or an arm at every step would differ from a server.
TEST(Envelope, StepsAreObservedAsTheirChunk) {
  const MethodOptions method = *MakeMethod("ours_following_step", {"envelope_share=0.2"});
  const ResidualOptions residual = ResidualOptionsOf(method);
  CommandCorrection whole(method, residual, {}), steps(method, residual, {});
  DisturbedArm free(0.6, Vector6::Zero()), held(0, Vector6::Zero());
  for (const ExecutedChunk& chunk :
       {free.Execute(kAhead, Vector6::Zero(), 8), held.Execute(2 * kAhead, Vector6::Zero(), 40)}) {
    whole.Observe(chunk);
    for (size_t i = 0; i < chunk.steps.size(); ++i) steps.Observe(StepOf(chunk, i));
  }
  EXPECT_EQ(whole.state(), steps.state());
  CommandCorrection copied(whole);
  copied.Observe(held.Execute(2 * kAhead, Vector6::Zero(), 100));
  EXPECT_LT(copied.Value().cwiseAbs().maxCoeff(), 1e-6) << "back to zero";
  EXPECT_EQ(whole.state(), steps.state()) << "a copy has an envelope of its own";
}

TEST(Envelope, GoesWithIntegralActionAndModelFollowingAlone) {
  EXPECT_TRUE(MakeMethod("ours_integral", {"envelope_share=0.2"}).ok());
  for (const char* preset : {"base", "direct", "ours", "smooth"}) {
    const auto method = MakeMethod(preset, {"envelope_share=0.2"});
    const absl::Status status = method.ok() ? method->Check() : method.status();
    EXPECT_NE(status.message().find("envelope_share bounds"), std::string::npos) << preset;
  }
}

}  // namespace
}  // namespace robostress
