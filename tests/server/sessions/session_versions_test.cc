#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <thread>

#include "server/sessions/session.h"
#include "tests/server/sessions/drive.h"

// A session's adapter over its life: guarded, kept, pinned, exported, rolled back.

namespace robostress {
namespace {

using ::testing::HasSubstr;

// ------------------------------------------------------------------------------------------ guard

std::shared_ptr<Session> Guarded(Rig& rig, const GuardOptions& guard) {
  auto session =
      Session::Create(Spec("ours", {kRate}), {rig.policy, &rig.adaptation, &rig.inference},
                      ++rig.last_owner, guard);
  EXPECT_TRUE(session.ok()) << session.status();
  return *session;
}

TEST(Session, AGuardThatAcceptsEverythingChangesNoBit) {
  Rig rig;
  GuardOptions lenient;
  lenient.enabled = true;
  lenient.max_loss_ratio = 1e6;
  Client guarded(Guarded(rig, lenient)), plain(rig.Open(Spec("ours", {kRate})));
  for (Client* client : {&guarded, &plain}) {
    client->StartEpisode(0, 0);
    client->RunChunks(60);
  }
  EXPECT_EQ(ExportOf(guarded.session()), ExportOf(plain.session()));
  EXPECT_EQ(guarded.updates(), 4u);
}

TEST(Session, ARefusedUpdateIsCountedAndLeavesLoraAndAdamAlone) {
  Rig rig;
  GuardOptions near, strict;
  near.enabled = strict.enabled = true;
  near.max_distance = 1e-9;
  strict.max_loss_ratio = 1e-6;
  for (const GuardOptions& guard : {near, strict}) {
    Client client(Guarded(rig, guard));
    client.StartEpisode(0, 0);
    client.RunChunks(48);
    EXPECT_EQ(client.updates(), 0u);
    EXPECT_EQ(client.session().Counters()->updates_guarded, 3u);
    EXPECT_EQ(client.session().Counters()->updates_refused, 0u);
    const AdaptationState state = StateOf(rig, client.session());
    EXPECT_EQ(state.lora.adam.steps, 0);
    EXPECT_EQ(state.lora.adam.m[0].abs().max().item<float>(), 0);
    EXPECT_EQ(client.Predict().adapter_version, 0u);
  }
}

TEST(Session, KeepsSixteenVersionsAndEveryPinnedOne) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunks(48);
  ASSERT_TRUE(client.session().Pin(2, true).ok());
  client.RunChunks(8 * 20);
  EXPECT_EQ(client.updates(), 23u);
  std::vector<uint64_t> held;
  const std::vector<PublishedVersion> versions = client.session().Versions().value();
  for (const PublishedVersion& version : versions) held.push_back(version.weights->version);
  EXPECT_EQ(held.size(), 18u);
  EXPECT_EQ(held[0], 0u);
  EXPECT_EQ(held[1], 2u);
  EXPECT_EQ(held[2], 8u);
  EXPECT_EQ(held.back(), 23u);
  EXPECT_EQ(client.session().Pin(3, true).code(), absl::StatusCode::kNotFound);
  ASSERT_TRUE(client.session().Rollback(2).ok());
  EXPECT_EQ(client.updates(), 2u);
}

TEST(Session, ListsVersionsWhileItRollsBackAndImports) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunks(40);
  const std::string saved = ExportOf(client.session());
  std::atomic<bool> over = false;
  std::vector<std::thread> readers;
  for (int i = 0; i < 3; ++i) {
    readers.emplace_back([&] {
      while (!over) {
        const auto versions = client.session().Versions();
        ASSERT_TRUE(versions.ok()) << versions.status();
        ASSERT_FALSE(versions->empty());
        EXPECT_EQ(versions->front().weights->version, 0u);
        EXPECT_TRUE(client.session().ExportVersion(0).ok());
      }
    });
  }
  for (int i = 0; i < 100; ++i) {
    EXPECT_TRUE(client.session().Rollback(0).ok());
    EXPECT_TRUE(client.session().Import(saved).ok());
  }
  over = true;
  for (std::thread& reader : readers) reader.join();
  EXPECT_EQ(client.updates(), 2u);
}

// ------------------------------------------------------------------------------- export and import

TEST(Session, ContinuesBitForBitFromAnExport) {
  Rig rig;
  using Case = std::pair<const char*, std::vector<std::string>>;
  for (const auto& [method, overrides] :
       {Case{"ours", {kRate}}, Case{"ours_intent", {kRate}}, Case{"ours_nominal", {kRate}},
        Case{"ours_nominal", {kRate, "target=nominal_intent"}},
        Case{"ours", {kRate, "target=sent"}}}) {
    const SessionSpec spec = Spec(method, overrides);
    Client client(rig.Open(spec));
    client.StartEpisode(0, 0);
    client.RunChunks(43);
    const std::string saved = ExportOf(client.session());

    // The copy takes over in the middle of the buffer's cycle, at an episode boundary.
    Client copy = client;
    copy.set_session(rig.Open(spec));
    const auto imported = copy.session().Import(saved);
    ASSERT_TRUE(imported.ok()) << imported.status();
    EXPECT_EQ(imported->sequence, 43u);
    EXPECT_EQ(imported->updates_applied, 2u);
    EXPECT_EQ(ExportOf(copy.session()), saved);
    for (Client* c : {&client, &copy}) {
      c->StartEpisode(0, 1);
      c->RunChunks(20);
    }
    EXPECT_EQ(ExportOf(copy.session()), ExportOf(client.session())) << method;
    EXPECT_EQ(copy.Predict().actions, client.Predict().actions);
  }
}

TEST(Session, ImportRefusesAnotherMethodsAdapterAndRubbish) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  const std::string saved = ExportOf(client.session());
  const auto other = rig.Open(Spec("no_anchor", {kRate}));
  EXPECT_THAT(std::string(other->Import(saved).status().message()),
              HasSubstr("learned by method ours"));
  EXPECT_EQ(client.session().Import("rubbish").status().code(), absl::StatusCode::kInvalidArgument);
  const auto rank = rig.Open(Spec("ours", {kRate, "rank=2"}));
  EXPECT_EQ(rank->Import(saved).status().code(), absl::StatusCode::kInvalidArgument);
  EXPECT_EQ(rig.Open(Spec("base"))->Export().status().code(),
            absl::StatusCode::kFailedPrecondition);
}

TEST(Session, RollsBackWithANewBuffer) {
  Rig rig;
  Client client(rig.Open(Spec("ours", {kRate})));
  client.StartEpisode(0, 0);
  client.RunChunks(48);
  EXPECT_EQ(client.updates(), 3u);
  ASSERT_TRUE(client.session().Rollback(1).ok());
  EXPECT_EQ(client.updates(), 1u);
  EXPECT_EQ(client.session().Counters()->buffered_chunks, 0);
  EXPECT_EQ(client.session().Rollback(3).code(), absl::StatusCode::kNotFound);
}

}  // namespace
}  // namespace robostress
