#include "server/inference/prefix_store.h"

#include <gtest/gtest.h>

#include <thread>

#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

// The bytes of one of the fake's contexts: keys and values 1 x 1 x 2 x 4 floats, mask 2, state 3
// floats.
constexpr int64_t kContextBytes = 2 * 32 + 2 + 12;

class PrefixStoreTest : public ::testing::Test {
 protected:
  std::shared_ptr<const PrefixStore::Prefix> Add(PrefixStore& store, int index) {
    auto observation = std::make_shared<const Observation>(FakePolicy::MakeObservation(index));
    return store.Add(policy_, observation, *policy_->Encode(*observation));
  }
  bool IsObservation(const PolicyContext& context, int index) {
    const PolicyContext expected = *policy_->Encode(FakePolicy::MakeObservation(index));
    return BitEqual(context.keys[0], expected.keys[0]) &&
           BitEqual(context.values[0], expected.values[0]) &&
           BitEqual(context.prefix_mask, expected.prefix_mask) &&
           BitEqual(context.state, expected.state);
  }
  std::shared_ptr<const FakePolicy> policy_ = std::make_shared<FakePolicy>();
};

TEST_F(PrefixStoreTest, DropsTheLeastRecentlyUsedAndRebuildsItToTheSameBits) {
  PrefixStore store(2 * kContextBytes);
  const auto a = Add(store, 0), b = Add(store, 1);
  EXPECT_TRUE(store.Get(*a).ok());  // b is now the older one
  const auto c = Add(store, 2);
  EXPECT_EQ(store.counters().bytes, 2 * kContextBytes);
  EXPECT_EQ(store.counters().evictions, 1u);
  EXPECT_TRUE(IsObservation(*store.Get(*a), 0));
  EXPECT_TRUE(IsObservation(*store.Get(*c), 2));
  EXPECT_EQ(store.counters().rebuilds, 0u);
  EXPECT_TRUE(IsObservation(*store.Get(*b), 1));
  EXPECT_EQ(store.counters().rebuilds, 1u);
  EXPECT_EQ(store.counters().bytes, 2 * kContextBytes);
}

TEST_F(PrefixStoreTest, HoldsNothingWithoutABudgetAndStillAnswers) {
  PrefixStore store(0);
  const auto a = Add(store, 0), b = Add(store, 1);
  EXPECT_EQ(store.counters().bytes, 0);
  EXPECT_GT(store.counters().observation_bytes, 0);
  for (int i = 0; i < 2; ++i) EXPECT_TRUE(IsObservation(*store.Get(*b), 1));
  EXPECT_EQ(store.counters().rebuilds, 2u);
  EXPECT_EQ(store.counters().bytes, 0);
}

TEST_F(PrefixStoreTest, NeverDropsWhatItCannotRebuild) {
  PrefixStore store(kContextBytes);
  const auto pinned = store.Add(policy_, nullptr, *policy_->Encode(FakePolicy::MakeObservation(7)));
  const auto a = Add(store, 0);
  EXPECT_EQ(store.counters().pinned_bytes, kContextBytes);
  EXPECT_EQ(store.counters().bytes, kContextBytes);
  EXPECT_TRUE(IsObservation(*store.Get(*pinned), 7));
  EXPECT_EQ(store.counters().rebuilds, 0u);
}

TEST_F(PrefixStoreTest, ForgetsAPrefixWithItsLastHandle) {
  PrefixStore store(100 * kContextBytes);
  auto a = Add(store, 0);
  const auto b = Add(store, 1);
  a.reset();
  EXPECT_EQ(store.counters().bytes, kContextBytes);
  PrefixStore none(0);
  { const auto c = Add(none, 0); }
  EXPECT_EQ(none.counters().observation_bytes, 0);
}

TEST_F(PrefixStoreTest, ServesThreadsThatEvictEachOther) {
  PrefixStore store(2 * kContextBytes);
  std::vector<std::shared_ptr<const PrefixStore::Prefix>> prefixes;
  for (int i = 0; i < 6; ++i) prefixes.push_back(Add(store, i));
  std::vector<std::thread> threads;
  for (int t = 0; t < 3; ++t) {
    threads.emplace_back([&, t] {
      for (int i = 0; i < 60; ++i) {
        const int index = (i * (t + 1)) % 6;
        EXPECT_TRUE(IsObservation(*store.Get(*prefixes[index]), index));
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_LE(store.counters().bytes, 2 * kContextBytes);
}

// Served episodes with every budget: the same predictions and the same adapter.
TEST_F(PrefixStoreTest, TheBudgetChangesNoBitOfASession) {
  const auto run = [](int64_t budget, PrefixStore::Counters* counters) {
    Rig rig;
    SessionResources resources{rig.policy, &rig.adaptation, &rig.inference, absl::Seconds(20),
                               std::make_shared<PrefixStore>(budget)};
    Client client(*Session::Create(Spec("ours"), resources, 1));
    std::string bits;
    for (int episode = 0; episode < 2; ++episode) {
      client.StartEpisode(0, episode);
      for (int i = 0; i < 30; ++i) {
        const PredictedChunk chunk = client.RunChunk();
        bits.append(reinterpret_cast<const char*>(chunk.actions.data()),
                    chunk.actions.size() * sizeof(float));
      }
    }
    *counters = client.session().Counters()->prefixes;
    return bits + ExportOf(client.session());
  };
  PrefixStore::Counters none, some, plenty;
  const std::string reference = run(PrefixStore::kDefaultBudgetBytes, &plenty);
  EXPECT_EQ(run(0, &none), reference);
  EXPECT_EQ(run(10 * kContextBytes, &some), reference);
  EXPECT_EQ(plenty.rebuilds, 0u);
  EXPECT_EQ(plenty.bytes, 32 * kContextBytes);
  EXPECT_EQ(none.rebuilds, 4u * 4u);  // updates after chunks 32, 40, 48, 56
  EXPECT_EQ(none.bytes, 0);
  EXPECT_LE(some.bytes, 10 * kContextBytes);
  EXPECT_GT(some.rebuilds, 0u);
}

TEST_F(PrefixStoreTest, AnImportedBufferContinuesToTheSameBits) {
  Rig rig;
  Client a(rig.Open(Spec("ours")));
  a.StartEpisode(0, 0);
  a.RunChunks(36);
  const std::string state = ExportOf(a.session());
  SessionResources tight{rig.policy, &rig.adaptation, &rig.inference, absl::Seconds(20),
                         std::make_shared<PrefixStore>(0)};
  const auto imported = *Session::Create(Spec("ours"), tight, 99);
  ASSERT_TRUE(imported->Import(state).ok());
  EXPECT_EQ(imported->Counters()->prefixes.pinned_bytes, 32 * kContextBytes);
  EXPECT_EQ(ExportOf(*imported), state);
}

}  // namespace
}  // namespace robostress
