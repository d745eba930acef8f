#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/atomic_file.h"
#include "common/rollout/message_limits.h"
#include "common/rpc/convert_specs.h"
#include "proto/robostress/v1/state.pb.h"
#include "server/sessions/journal/session_journal.h"
#include "server/sessions/read_spec.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// A session with a folder, and the end of its server at any moment.
class DurableSession : public ::testing::Test {
 protected:
  DurableSession()
      : root_(fs::path(::testing::TempDir()) / absl::StrCat("durable-", getpid())),
        folder_((root_ / "session").string()) {
    fs::remove_all(root_);
    fs::create_directories(root_);
  }
  ~DurableSession() override { fs::remove_all(root_); }

  SessionResources Resources(Rig& rig) const {
    SessionResources resources{rig.policy, &rig.adaptation, &rig.inference, absl::Seconds(20)};
    resources.snapshot_records = snapshot_records_;
    return resources;
  }
  std::shared_ptr<Session> Make(Rig& rig) const {
    auto session = Session::Create(spec_, Resources(rig), ++rig.last_owner, guard_);
    EXPECT_TRUE(session.ok()) << session.status();
    return *session;
  }
  std::shared_ptr<Session> Begin(Rig& rig) const {
    v1::StateHeader header;
    header.set_session_id("session");
    *header.mutable_spec() = ToProto(RequestOf(spec_));
    header.set_model_hash("fake-hash");
    auto journal = SessionJournal::Create(folder_, header);
    EXPECT_TRUE(journal.ok()) << journal.status();
    auto session = Make(rig);
    session->SetJournal(*std::move(journal));
    return session;
  }
  // As a restarted server does: nothing of the old one's memory is left.
  std::shared_ptr<Session> Again(Rig& rig, const std::string& folder = "") const {
    auto session = Make(rig);
    const absl::Status status = session->Recover(folder.empty() ? folder_ : folder);
    EXPECT_TRUE(status.ok()) << status;
    return session;
  }

  const fs::path root_;
  const std::string folder_;
  SessionSpec spec_ = Spec("ours", {kRate});
  GuardOptions guard_;
  uint64_t snapshot_records_ = 1000000;
};

// Everything that a session does, in an order that is always the same.
void RunStep(Client& client, int step) {
  if (step % 25 == 0) client.StartEpisode(step / 100, step / 25);
  client.RunChunk(1 + step % 5);
  if (step == 130) {
    ASSERT_TRUE(client.session().Pin(2, true).ok());
  }
  if (step == 140) {
    ASSERT_TRUE(client.session().Rollback(2).ok());
  }
}

std::string VersionsOf(Session& session) {
  std::string text;
  const std::vector<PublishedVersion> versions = session.Versions().value();
  for (const PublishedVersion& held : versions) {
    absl::StrAppend(&text, held.weights->version, held.pinned ? " pinned " : " ", held.distance,
                    " ", held.loss, " ", held.feedback_sequence, "\n");
  }
  return text;
}

TEST_F(DurableSession, ContinuesBitForBitWhereverItsServerEnded) {
  for (const uint64_t snapshot_records : {1000000, 37}) {
    snapshot_records_ = snapshot_records;
    fs::remove_all(folder_);
    Rig rig;
    Client straight(Make(rig));
    Client restarted(Begin(rig));
    RandomStream ends(StreamKey("ends"));
    int restarts = 0;
    for (int step = 0; step < 200; ++step) {
      RunStep(straight, step);
      RunStep(restarted, step);
      if (ends.Uniform() > 0.1) continue;
      restarted.session().Cancel();  // whatever it was about to do, it does not do
      restarted.set_session(Again(rig));
      ++restarts;
    }
    EXPECT_GT(restarts, 10);
    EXPECT_GT(straight.updates(), 4u);
    EXPECT_EQ(ExportOf(restarted.session()), ExportOf(straight.session()));
    EXPECT_EQ(VersionsOf(restarted.session()), VersionsOf(straight.session()));
    EXPECT_EQ(restarted.session().Counters()->rollbacks, 1u);
    EXPECT_EQ(restarted.session().ExportVersion(2).value(),
              straight.session().ExportVersion(2).value());
    EXPECT_EQ(fs::exists(folder_ + "/journal-000000"), snapshot_records == 1000000);
  }
}

TEST_F(DurableSession, TakesFeedbackOfAPredictionThatItsPredecessorMade) {
  Rig rig;
  Client client(Begin(rig));
  client.StartEpisode(0, 0);
  client.RunChunks(31);
  const ExecutedChunk late = client.Execute(client.Predict());
  client.set_session(Again(rig));
  client.Send(late);
  EXPECT_EQ(client.updates(), 1u);
  client.RunChunk();
}

TEST_F(DurableSession, RecallsWhatWasAnsweredAndWhereTheEpisodeStands) {
  for (const char* method : {"base", "ours_integral", "ours_intent"}) {
    for (const bool flushed : {false, true}) {
      fs::remove_all(folder_);
      spec_ = Spec(method);
      Rig rig;
      Client client(Begin(rig));
      client.StartEpisode(2, 5);
      client.RunChunks(3);
      const PredictedChunk answered = client.Predict();
      EXPECT_TRUE(!flushed || client.session().Flush().ok());
      client.session().Cancel();
      const auto again = Again(rig);
      const auto recalled = again->Recall(answered.prediction_id);
      ASSERT_TRUE(recalled.ok()) << recalled.status();
      ASSERT_NE(recalled->answered, nullptr);
      EXPECT_EQ(recalled->answered->actions, answered.actions);
      EXPECT_EQ(recalled->answered->policy_actions, answered.policy_actions);
      EXPECT_EQ(recalled->answered->base_actions, answered.base_actions);
      EXPECT_EQ(recalled->answered->adapter_version, answered.adapter_version);
      EXPECT_EQ(recalled->key, (ChunkKey{{2, 5}, 3}));
      EXPECT_EQ(again->Recall(0)->id, answered.prediction_id);
      EXPECT_EQ(again->Position().episode, (EpisodeKey{2, 5}));
      EXPECT_EQ(again->Position().next_chunk, 4);
      const absl::Status unknown = again->Recall(99).status();
      EXPECT_EQ(unknown.code(), absl::StatusCode::kFailedPrecondition);
      EXPECT_THAT(std::string(unknown.message()), HasSubstr("prediction 99 is not one"));
      EXPECT_FALSE(again->Repeated(4).has_value());
      ASSERT_TRUE(again->Repeated(3).has_value());
      EXPECT_EQ(again->CountersNow().duplicates, 1u);
      ASSERT_TRUE(again->StartEpisode({2, 6}, 3).ok());
      EXPECT_EQ(again->Position().next_chunk, 0);
    }
  }
}

TEST_F(DurableSession, AnUpdateUnderWayAtTheEndIsMadeAgain) {
  spec_.mode = ExecutionMode::kAsync;
  Rig rig;
  Client client(Begin(rig));
  client.StartEpisode(0, 0);
  for (int i = 0; i < 5; ++i) {
    client.RunChunks(32 + 8 * i);
    client.session().Cancel();  // right behind the trigger
    client.set_session(Again(rig));
  }
  // Chunk by chunk what was in is the same as without an end: 32, 40 ... 240.
  EXPECT_EQ(client.sequence(), 240u);
  ExportOf(client.session());  // every update due
  EXPECT_EQ(client.updates(), 27u);
}

TEST_F(DurableSession, EndsAtAnyByteOfItsJournalAndKeepsAWholePrefix) {
  Rig rig;
  spec_.method = *MakeMethod("ours", {kRate, "buffer_chunks=4", "update_interval=2", "batch=2"});
  Client client(Begin(rig));
  client.StartEpisode(0, 0);
  std::vector<std::string> after{ExportOf(client.session())};
  for (int i = 0; i < 6; ++i) {
    client.RunChunk();
    after.push_back(ExportOf(client.session()));
  }
  client.session().Cancel();
  const std::string journal = *ReadFile(folder_ + "/journal-000000");
  const std::string cut_folder = (root_ / "cut").string();
  fs::create_directories(cut_folder);
  uint64_t last = 0;
  for (size_t cut = journal.size() / 2; cut <= journal.size(); cut += 97) {
    ASSERT_TRUE(WriteFileAtomically(cut_folder + "/journal-000000", journal.substr(0, cut)).ok());
    const auto session = Again(rig, cut_folder);
    const uint64_t in = session->Position().feedback_sequence;
    ASSERT_LT(in, after.size());
    EXPECT_GE(in, last);
    EXPECT_EQ(ExportOf(*session), after[in]) << "cut at byte " << cut;
    last = in;
  }
  EXPECT_GE(last, 5u);
}

TEST_F(DurableSession, ADamagedSnapshotIsReplacedByTheOneBeforeIt) {
  snapshot_records_ = 30;
  Rig rig;
  Client client(Begin(rig));
  client.StartEpisode(0, 0);
  client.RunChunks(100);
  const std::string expected = ExportOf(client.session());
  client.session().Cancel();
  std::string newest;
  for (const auto& entry : fs::directory_iterator(folder_)) {
    const std::string name = entry.path().filename().string();
    if (name.rfind("snapshot-", 0) == 0) newest = std::max(newest, entry.path().string());
  }
  std::string bytes = *ReadFile(newest);
  bytes[bytes.size() / 3] = static_cast<char>(bytes[bytes.size() / 3] ^ 1);
  ASSERT_TRUE(WriteFileAtomically(newest, bytes).ok());
  EXPECT_EQ(ExportOf(*Again(rig)), expected);
  ASSERT_TRUE(WriteFileAtomically(newest, bytes.substr(0, bytes.size() / 2)).ok());
  EXPECT_EQ(ExportOf(*Again(rig)), expected);
  ASSERT_TRUE(WriteFileAtomically(newest, "").ok());
  EXPECT_EQ(ExportOf(*Again(rig)), expected);
}

TEST_F(DurableSession, ADamagedJournalIsDataLossAndAnotherBaseModelIsRefused) {
  Rig rig;
  Client client(Begin(rig));
  client.StartEpisode(0, 0);
  client.RunChunks(10);
  client.session().Cancel();
  std::string bytes = *ReadFile(folder_ + "/journal-000000");
  bytes[bytes.size() / 2] = static_cast<char>(bytes[bytes.size() / 2] ^ 1);
  ASSERT_TRUE(WriteFileAtomically(folder_ + "/journal-000000", bytes).ok());
  EXPECT_EQ(Make(rig)->Recover(folder_).code(), absl::StatusCode::kDataLoss);

  fs::remove_all(folder_);
  Client other(Begin(rig));
  Rig foreign;
  foreign.policy = std::make_shared<FakePolicy>("other-hash");
  const absl::Status status = Make(foreign)->Recover(folder_);
  EXPECT_EQ(status.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(status.message()), HasSubstr("was adapted on weights 'fake-hash'"));
}

TEST_F(DurableSession, AFullDiskRefusesFeedbackTakesNothingAndStopsNoPrediction) {
  std::signal(SIGXFSZ, SIG_IGN);
  rlimit before{};
  getrlimit(RLIMIT_FSIZE, &before);
  Rig rig;
  Client straight(Make(rig)), client(Begin(rig));
  for (Client* each : {&straight, &client}) {
    each->StartEpisode(0, 0);
    each->RunChunks(40);
  }
  const rlimit full{fs::file_size(folder_ + "/journal-000000") + 10, before.rlim_max};
  setrlimit(RLIMIT_FSIZE, &full);
  const ExecutedChunk chunk = client.Execute(client.Predict());
  const auto refused = client.session().Feedback(chunk);
  const SessionCounters counters = *client.session().Counters();
  const absl::Status episode = client.session().StartEpisode({1, 0}, 40);
  setrlimit(RLIMIT_FSIZE, &before);
  EXPECT_EQ(refused.status().code(), absl::StatusCode::kResourceExhausted) << refused.status();
  EXPECT_FALSE(episode.ok());
  EXPECT_EQ(counters.stats.feedback_chunks, 40u);
  EXPECT_EQ(counters.predictions_unkept, 1u);
  client.Send(chunk);  // room again
  straight.RunChunk();
  client.RunChunks(10);
  straight.RunChunks(10);
  EXPECT_EQ(ExportOf(client.session()), ExportOf(straight.session()));
  EXPECT_EQ(ExportOf(*Again(rig)), ExportOf(straight.session()));
}

TEST_F(DurableSession, PredictionsThatNoFeedbackFollowsDoNotFillTheDisk) {
  for (const char* method : {"base", "ours"}) {
    fs::remove_all(folder_);
    spec_ = Spec(method);
    snapshot_records_ = 16;
    Rig rig;
    Client client(Begin(rig));
    client.StartEpisode(0, 0);
    client.Predict();
    const uint64_t one = client.session().CountersNow().journal_bytes;
    for (int i = 0; i < 400; ++i) client.Predict();
    const auto bytes = [&] { return client.session().CountersNow().journal_bytes; };
    for (int i = 0; i < 500 && bytes() > 32 * one; ++i) {
      client.Predict();
      absl::SleepFor(absl::Milliseconds(10));
    }
    EXPECT_LE(bytes(), 32 * one) << method;
    const SessionPosition before = client.session().Position();
    client.session().Cancel();
    const auto again = Again(rig);
    EXPECT_EQ(again->Position().last_prediction_id, before.last_prediction_id);
    EXPECT_EQ(again->Position().next_chunk, before.next_chunk);
  }
}

TEST_F(DurableSession, WhatItAnsweredItCanReadAgainUpToTheGreatestNumbers) {
  Rig rig;
  const auto session = Begin(rig);
  ASSERT_TRUE(session->StartEpisode({0, WireLimits::kIndex}, 0).ok());
  const auto predict = [&](int task, int episode, int chunk) {
    return session->Predict(Shared(FakePolicy::MakeObservation(0)), {{task, episode}, chunk}, 0);
  };
  ASSERT_TRUE(predict(0, WireLimits::kIndex, WireLimits::kIndex).ok());
  const absl::Status above = predict(0, WireLimits::kIndex, WireLimits::kIndex + 1).status();
  EXPECT_EQ(above.code(), absl::StatusCode::kInvalidArgument);
  EXPECT_THAT(std::string(above.message()), HasSubstr("chunk is 16777217"));
  Observation latin = FakePolicy::MakeObservation(0);
  latin.instruction = "caf\xe9";
  EXPECT_THAT(
      std::string(
          session->Predict(Shared(latin), {{0, WireLimits::kIndex}, 1}, 0).status().message()),
      HasSubstr("instruction: byte 4 of 4 (233) is not UTF-8"));
  ASSERT_TRUE(session->Flush().ok());
  session->Cancel();
  EXPECT_EQ(Again(rig)->Position().next_chunk, WireLimits::kIndex);
}

TEST_F(DurableSession, AnImportLeavesNoEpisodeToPredictIn) {
  Rig rig;
  Client source(rig.Open(spec_));
  source.StartEpisode(4, 0);
  source.RunChunks(40);
  const auto session = Begin(rig);
  ASSERT_TRUE(session->Import(ExportOf(source.session())).ok());
  EXPECT_EQ(
      session->Predict(Shared(FakePolicy::MakeObservation(0)), {{4, -1}, 0}, 40).status().code(),
      absl::StatusCode::kInvalidArgument);
}

TEST_F(DurableSession, DuplicatesAreAcknowledgedCountedAndHaveNoEffect) {
  Rig rig;
  Client straight(Make(rig)), client(Begin(rig));
  std::vector<ExecutedChunk> sent;
  for (Client* each : {&straight, &client}) each->StartEpisode(0, 0);
  for (int i = 0; i < 50; ++i) {
    straight.RunChunk();
    sent.push_back(client.Execute(client.Predict()));
    client.Send(sent.back());
    for (const size_t again : {sent.size() - 1, sent.size() / 2}) {
      const auto result = client.session().Feedback(sent[again]);
      ASSERT_TRUE(result.ok()) << result.status();
      EXPECT_TRUE(result->duplicate && result->durable);
      EXPECT_EQ(result->sequence, sent.size());
    }
  }
  EXPECT_EQ(client.session().Counters()->duplicates, 100u);
  EXPECT_EQ(ExportOf(client.session()), ExportOf(straight.session()));
}

TEST_F(DurableSession, KeepsAnImportedAdapterItsGuardAndTheDirectCorrection) {
  Rig rig;
  Client source(rig.Open(spec_));
  source.StartEpisode(0, 0);
  source.RunChunks(50);
  snapshot_records_ = 25;
  guard_.enabled = true;
  guard_.max_loss_ratio = 0.999;
  Client straight(Make(rig)), client(Begin(rig));
  for (Client* each : {&straight, &client}) {
    ASSERT_TRUE(each->session().Import(ExportOf(source.session())).ok());
    each->set_sequence(50);
    each->StartEpisode(0, 1);
    each->RunChunks(30);
  }
  client.session().Cancel();
  client.set_session(Again(rig));
  for (Client* each : {&straight, &client}) each->RunChunks(30);
  EXPECT_EQ(ExportOf(client.session()), ExportOf(straight.session()));
  EXPECT_EQ(client.session().Counters()->updates_guarded,
            straight.session().Counters()->updates_guarded);

  guard_ = {};
  for (const char* method : {"direct", "ours_integral", "ours_following"}) {
    fs::remove_all(folder_);
    spec_ = Spec(method);
    Client straight(Make(rig)), kept(Begin(rig));
    for (Client* each : {&straight, &kept}) {
      each->StartEpisode(0, 0);
      each->RunChunks(40);
    }
    kept.session().Cancel();
    kept.set_session(Again(rig));
    EXPECT_EQ(kept.Predict().actions, straight.Predict().actions) << method;
  }
}

}  // namespace
}  // namespace robostress
