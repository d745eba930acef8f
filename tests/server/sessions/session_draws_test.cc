// What a session draws: noise that pairs episodes of two methods, batches that differ.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <torch/types.h>

#include <algorithm>
#include <memory>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "absl/synchronization/mutex.h"
#include "server/sessions/prediction.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

std::pair<uint64_t, uint64_t> Key(const SessionSpec& spec, int task = 1, int episode = 2,
                                  int chunk = 3) {
  const StreamKey key = NoiseKey(spec, {{task, episode}, chunk});
  return {key.lo(), key.hi()};
}

TEST(NoiseKey, DependsOnSeedSuiteTaskEpisodeChunkAndStreamAndOnNothingElse) {
  const SessionSpec base = Spec("base");
  SessionSpec other_seed = base, other_suite = base;
  other_seed.seed = 4;
  other_suite.suite = "tabletop_long";
  std::set<std::pair<uint64_t, uint64_t>> keys = {
      Key(base),         Key(base, 0),    Key(base, 1, 0),  Key(base, 1, 2, 0),
      Key(Spec("null")), Key(other_seed), Key(other_suite), Key(base, 2, 1)};
  EXPECT_EQ(keys.size(), 8u);
  // Episodes of two methods under two scenarios are pairs.
  SessionSpec paired = Spec("ours_following");
  paired.scenario = "aged_joint_elbow";
  paired.severity = 2;
  EXPECT_EQ(Key(paired), Key(base));
}

TEST(SessionIdentity, HoldsAllThatTellsOneAdapterFromAnother) {
  const SessionSpec spec = Spec("ours");
  std::set<std::string> identities = {SessionIdentity(spec), SessionIdentity(Spec("no_anchor"))};
  SessionSpec other = spec;
  other.seed = 4;
  identities.insert(SessionIdentity(other));
  other = spec;
  other.severity = spec.severity - 1;
  identities.insert(SessionIdentity(other));
  other = spec;
  other.scenario = "clean";
  identities.insert(SessionIdentity(other));
  other = spec;
  other.suite = "tabletop_long";
  identities.insert(SessionIdentity(other));
  other = spec;
  other.policy = "another";
  identities.insert(SessionIdentity(other));
  EXPECT_EQ(identities.size(), 7u);
}

// Remembers the states of the contexts that updates were made of.
class WatchedPolicy : public FakePolicy {
 public:
  torch::Tensor Velocity(const PolicyContext& context, const torch::Tensor& x_u,
                         const torch::Tensor& u, const LoraWeights* lora) const override {
    if (torch::GradMode::is_enabled()) {
      absl::MutexLock lock(&mu_);
      batches_.emplace_back();
      for (int64_t row = 0; row < context.state.size(0); ++row)
        batches_.back().push_back(context.state[row][0].item<float>());
    }
    return FakePolicy::Velocity(context, x_u, u, lora);
  }
  std::vector<std::vector<float>> batches() const {
    absl::MutexLock lock(&mu_);
    return batches_;
  }

 private:
  mutable absl::Mutex mu_;
  mutable std::vector<std::vector<float>> batches_ ABSL_GUARDED_BY(mu_);
};

TEST(Session, EveryUpdateDrawsPlacesOfItsOwnFromTheBuffer) {
  Rig rig;
  const auto policy = std::make_shared<WatchedPolicy>();
  rig.policy = policy;
  Client client(rig.Open(Spec("ours")));
  client.StartEpisode(0, 0);
  // The arm moves on and on, so that a chunk's state tells which one it is.
  std::vector<float> states;
  for (int chunk = 0; chunk < 72; ++chunk) {
    const PredictedChunk prediction = client.Predict();
    const ExecutedChunk executed = client.Execute(prediction);
    states.push_back(static_cast<float>(executed.steps[0].before.tool.p_base_tool.x()));
    client.Send(executed);
  }
  ASSERT_EQ(client.updates(), 6u);
  const auto batches = policy->batches();
  ASSERT_EQ(batches.size(), 6u);
  std::set<std::set<long>> places;
  for (size_t update = 0; update < batches.size(); ++update) {
    std::set<long> drawn;
    for (const float state : batches[update]) {
      const auto found = std::find(states.begin(), states.end(), state);
      ASSERT_NE(found, states.end());
      const long place = (found - states.begin()) - 8 * static_cast<long>(update);
      EXPECT_GE(place, 0) << "of the last 32 chunks";
      EXPECT_LT(place, 32);
      drawn.insert(place);
    }
    EXPECT_EQ(drawn.size(), 4u) << "without replacement";
    places.insert(drawn);
  }
  EXPECT_GE(places.size(), 5u) << "six times the same four of 32 are no sample";
}

TEST(Session, KeepsSixtyFourPredictionsWhoseFeedbackDoesNotCome) {
  Rig rig;
  SessionSpec spec = Spec("base");
  spec.mode = ExecutionMode::kAsync;
  Client client(rig.Open(spec));
  client.StartEpisode(0, 0);
  for (int i = 0; i < 70; ++i) client.Predict();
  EXPECT_EQ(client.session().Counters()->predictions_dropped, 6u);
  EXPECT_FALSE(client.session().Recall(6).ok());
  EXPECT_TRUE(client.session().Recall(7).ok());
}

}  // namespace
}  // namespace robostress
