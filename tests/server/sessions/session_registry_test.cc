#include "server/sessions/session_registry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "common/rollout/refusal.h"
#include "tests/server/sessions/drive.h"

namespace robostress {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class RegistryTest : public ::testing::Test {
 protected:
  RegistryTest() : folder_(absl::StrCat(::testing::TempDir(), "/registry-", getpid())) {
    fs::remove_all(folder_);
    options_.max_sessions = 3;
  }
  ~RegistryTest() override { fs::remove_all(folder_); }

  absl::Status TryStart() {
    registry_.reset();
    auto registry = SessionRegistry::Create(
        options_,
        [this](const std::string& policy) -> absl::StatusOr<SessionResources> {
          if (policy != "fake") return absl::NotFoundError(policy);
          return SessionResources{rig_.policy, &rig_.adaptation, &rig_.inference,
                                  absl::Seconds(20)};
        },
        &clock_);
    if (!registry.ok()) return registry.status();
    registry_ = *std::move(registry);
    return absl::OkStatus();
  }
  void Start() {
    const absl::Status status = TryStart();
    ASSERT_TRUE(status.ok()) << status;
  }
  void Durable() { options_.state_dir = folder_; }
  OpenedSession Open(const std::string& method = "ours", const Caller& caller = Anybody()) {
    SessionSpec spec = Spec(method);
    spec.method = *MakeMethodOf({"ours"}, method, {kRate});
    auto opened = registry_->Open({std::move(spec), {}, {}}, caller);
    EXPECT_TRUE(opened.ok()) << opened.status();
    return *std::move(opened);
  }
  int Folders() const {
    int count = 0;
    for (const auto& entry : fs::directory_iterator(folder_)) count += entry.is_directory();
    return count;
  }

  const std::string folder_;
  Rig rig_;
  ManualClock clock_{1'000'000'000};
  SessionRegistryOptions options_;
  std::unique_ptr<SessionRegistry> registry_;
};

TEST_F(RegistryTest, ResumesByTokenAfterARestartAndByNothingElse) {
  Durable();
  Start();
  const OpenedSession opened = Open(), other = Open();
  EXPECT_EQ(opened.token.size(), 32u);
  Client client(opened.session);
  client.StartEpisode(0, 0);
  client.RunChunks(45);
  const std::string before = ExportOf(*opened.session);
  Start();
  EXPECT_THAT(std::string(registry_->Use(opened.id).status().message()),
              HasSubstr("must be resumed with its token"));
  for (const std::string& wrong : {std::string(), other.token, opened.token.substr(1)})
    EXPECT_EQ(registry_->Resume(opened.id, wrong).status().code(),
              absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(registry_->Resume("session-0", opened.token).status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_EQ(registry_->Resume("../x", opened.token).status().code(), absl::StatusCode::kNotFound);
  const auto resumed = registry_->Resume(opened.id, opened.token);
  ASSERT_TRUE(resumed.ok()) << resumed.status();
  EXPECT_EQ(ExportOf(*resumed->session), before);
  EXPECT_EQ(resumed->session->Position().feedback_sequence, 45u);
  EXPECT_TRUE(registry_->Use(opened.id).ok());
  client.set_session(resumed->session);
  client.RunChunks(5);
}

TEST_F(RegistryTest, ResumesInMemoryAfterADisconnectAndNotAfterARestart) {
  Start();
  const OpenedSession opened = Open();
  EXPECT_EQ(registry_->Resume(opened.id, opened.token)->session, opened.session);
  Start();
  const absl::Status lost = registry_->Resume(opened.id, opened.token).status();
  EXPECT_EQ(lost.code(), absl::StatusCode::kNotFound);
  EXPECT_THAT(std::string(lost.message()), HasSubstr("open a new one"));
}

Caller Robot(const std::string& name, int sessions = 0) {
  Caller caller = Anybody();
  caller.name = name;
  caller.owner = "token:" + name;
  caller.limits.sessions = sessions;
  return caller;
}

TEST_F(RegistryTest, WritesTheSessionUnusedForLongestToDiskAndBringsItBackWithItsNextMessage) {
  Durable();
  Start();
  const OpenedSession first = Open();
  std::string before;
  {
    Client client(first.session);
    client.StartEpisode(0, 0);
    client.RunChunks(33);
    before = ExportOf(*first.session);
  }
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Seconds(5)));
  const OpenedSession second = Open(), third = Open();
  const absl::Status full = registry_->Open({Spec("ours"), {}, {}}).status();
  EXPECT_EQ(full.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_EQ(RetryAfter(full), absl::Seconds(5));
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Seconds(5)));
  Open();
  EXPECT_EQ(registry_->open_sessions(), 3);
  EXPECT_EQ(Folders(), 4);
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Seconds(10)));
  const auto used = registry_->Use(first.id);
  ASSERT_TRUE(used.ok()) << used.status();
  EXPECT_EQ(ExportOf(**used), before);
  EXPECT_EQ(registry_->open_sessions(), 3);
  EXPECT_EQ(Folders(), 3) << "one of those that were never used is closed";
  EXPECT_TRUE(registry_->Resume(first.id, first.token).ok());
}

TEST_F(RegistryTest, WhoNamesSessionsAndLeavesLocksNobodyOut) {
  for (const bool durable : {false, true}) {
    options_.state_dir = durable ? folder_ : "";
    Start();
    for (int i = 0; i < 20; ++i) {
      const OpenedSession opened = Open("ours", Robot("hit and run"));
      registry_->Attach(opened.id);
      Client client(opened.session);
      client.StartEpisode(0, 0);
      client.Predict();
      registry_->Detach(opened.id);
    }
    EXPECT_LE(registry_->open_sessions(), 3);
    EXPECT_TRUE(registry_->Open({Spec("ours"), {}, {}}, Robot("new robot")).ok());
  }
}

TEST_F(RegistryTest, ASessionIsItsOpenersAloneOnDiskToo) {
  Durable();
  Start();
  const OpenedSession opened = Open("ours", Robot("arm_1"));
  const auto refused = [&](const Caller& caller) {
    for (const absl::Status& status :
         {registry_->Use(opened.id, caller).status(), registry_->Close(opened.id, caller),
          registry_->Resume(opened.id, opened.token, caller).status()}) {
      EXPECT_EQ(status.code(), absl::StatusCode::kPermissionDenied) << status;
      EXPECT_THAT(std::string(status.message()), ::testing::Not(HasSubstr("arm_1")));
    }
  };
  refused(Robot("arm_2"));
  Caller certificate = Robot("");
  certificate.owner = "certificate:arm_1";
  refused(certificate);
  EXPECT_TRUE(registry_->Use(opened.id, Robot("arm_1")).ok());
  Start();
  refused(Robot("arm_2"));
  EXPECT_TRUE(registry_->Load(opened.id).ok()) << "an operator's";
  EXPECT_TRUE(registry_->Resume(opened.id, opened.token, Robot("arm_1")).ok());
  EXPECT_TRUE(registry_->Close(opened.id, Robot("arm_1")).ok());
}

TEST_F(RegistryTest, ASessionOfTimesWithoutTokensGoesToWhoHasItsResumeToken) {
  Durable();
  Start();
  const OpenedSession opened = Open();
  Start();
  EXPECT_TRUE(registry_->Resume(opened.id, opened.token, Robot("arm_1")).ok());
  EXPECT_EQ(registry_->Use(opened.id, Robot("arm_2")).status().code(),
            absl::StatusCode::kPermissionDenied);
  EXPECT_EQ(registry_->Resume(opened.id, opened.token, Robot("arm_2")).status().code(),
            absl::StatusCode::kPermissionDenied);
}

TEST_F(RegistryTest, ATokenHoldsSoManySessionsAndItsOwnMakeRoomForItsNext) {
  Start();
  const Caller arm = Robot("arm", 1);
  const OpenedSession first = Open("ours", arm);
  const absl::Status second = registry_->Open({Spec("ours"), {}, {}}, arm).status();
  EXPECT_EQ(second.code(), absl::StatusCode::kResourceExhausted);
  EXPECT_THAT(std::string(second.message()), HasSubstr("this client has 1 sessions"));
  EXPECT_TRUE(registry_->Open({Spec("ours"), {}, {}}, Robot("other")).ok());
  registry_->Attach(first.id);
  registry_->Detach(first.id);
  EXPECT_TRUE(registry_->Open({Spec("ours"), {}, {}}, arm).ok()) << "the first one was left";
  EXPECT_EQ(registry_->Use(first.id, arm).status().code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(registry_->open_sessions(), 2);
}

TEST_F(RegistryTest, ATokensLimitsBoundWhatItsMethodsAskFor) {
  Start();
  Caller arm = Robot("arm");
  const auto open = [&](const char* option) {
    return registry_->Open({Spec("ours", {option}), {}, {}}, arm).status();
  };
  EXPECT_TRUE(open("rank=8").ok());
  EXPECT_TRUE(open("update_interval=6").ok());
  arm.limits.rank = 4;
  arm.limits.update_interval = 8;
  EXPECT_THAT(std::string(open("rank=8").message()), HasSubstr("rank is 8"));
  EXPECT_THAT(std::string(open("update_interval=6").message()), HasSubstr("update_interval is 6"));
  EXPECT_TRUE(open("rank=4").ok());
}

TEST_F(RegistryTest, OneClientCannotFillTheDiskForTheOthers) {
  Durable();
  options_.max_stored_sessions = 8;
  Start();
  const auto open = [&](const std::string& name) {
    auto opened = registry_->Open({Spec("ours"), {}, {}}, Robot(name));
    if (!opened.ok()) return opened.status();
    Client client(opened->session);
    client.StartEpisode(0, 0);
    client.RunChunk();
    registry_->Attach(opened->id);
    registry_->Detach(opened->id);
    return absl::OkStatus();
  };
  for (int i = 0; i < 6; ++i) EXPECT_TRUE(open("many").ok());
  EXPECT_EQ(open("many").code(), absl::StatusCode::kResourceExhausted);
  EXPECT_TRUE(open("one").ok());
  EXPECT_TRUE(open("two").ok());
  EXPECT_EQ(open("three").code(), absl::StatusCode::kResourceExhausted) << "all have learned";
}

TEST_F(RegistryTest, AFullDiskForgetsTheOldestThatLearnedNothingAndOnlyWhenItWasLongLeft) {
  Durable();
  options_.max_sessions = 1;
  options_.max_stored_sessions = 6;  // four of them one client's
  Start();
  const auto open = [&](bool learns) {
    auto opened = registry_->Open({Spec("ours"), {}, {}}, Robot("arm"));
    if (!opened.ok()) return absl::StatusOr<std::string>(opened.status());
    Client client(opened->session);
    client.StartEpisode(0, 0);
    if (learns) {
      client.RunChunk();
    } else {
      client.Predict();
    }
    registry_->Attach(opened->id);
    registry_->Detach(opened->id);
    clock_.Advance(absl::ToInt64Nanoseconds(absl::Seconds(10)));
    return absl::StatusOr<std::string>(opened->id);
  };
  const std::string learned = *open(true), older = *open(false), newer = *open(false);
  ASSERT_TRUE(open(false).ok());
  EXPECT_EQ(open(false).status().code(), absl::StatusCode::kResourceExhausted)
      << "none was left for long";
  clock_.Advance(absl::ToInt64Nanoseconds(options_.abandoned_after - absl::Seconds(25)));
  ASSERT_TRUE(open(false).ok());
  EXPECT_EQ(Folders(), 4);
  EXPECT_EQ(registry_->Use(older, Robot("arm")).status().code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(registry_->Use(newer, Robot("arm")).ok()) << "it was left for less";
  EXPECT_TRUE(registry_->Use(learned, Robot("arm")).ok()) << "it was left for longest, and learned";
}

TEST_F(RegistryTest, ExpiresUnusedSessionsOnDiskTooButNotForAWallClockThatJumps) {
  Durable();
  options_.expire_after = absl::Hours(1);
  Start();
  const OpenedSession kept = Open(), expired = Open();
  // Files that look a year old: only time that this server has seen counts.
  for (const auto& entry : fs::recursive_directory_iterator(folder_)) {
    fs::last_write_time(entry.path(), fs::file_time_type::clock::now() - std::chrono::hours(9000));
  }
  Start();
  registry_->ExpireUnused();
  EXPECT_EQ(Folders(), 2);
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Minutes(50)));
  ASSERT_TRUE(registry_->Resume(kept.id, kept.token).ok());
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Minutes(11)));
  registry_->ExpireUnused();
  EXPECT_EQ(Folders(), 1);
  EXPECT_EQ(registry_->Resume(expired.id, expired.token).status().code(),
            absl::StatusCode::kNotFound);
  EXPECT_TRUE(registry_->Use(kept.id).ok());
}

TEST_F(RegistryTest, ClosingRemovesTheFolderAndOneFolderHasOneServer) {
  Durable();
  Start();
  const OpenedSession opened = Open();
  EXPECT_EQ(Folders(), 1);
  auto second = SessionRegistry::Create(
      options_, [](const std::string&) { return absl::NotFoundError("none"); }, &clock_);
  EXPECT_THAT(std::string(second.status().message()), HasSubstr("another server keeps"));
  ASSERT_TRUE(registry_->Close(opened.id).ok());
  EXPECT_EQ(Folders(), 0);
  EXPECT_EQ(registry_->Close(opened.id).code(), absl::StatusCode::kNotFound);
  EXPECT_EQ(registry_->Resume(opened.id, opened.token).status().code(),
            absl::StatusCode::kNotFound);
}

TEST_F(RegistryTest, AThousandSessionsOpenedAndDroppedLeaveNothing) {
  options_.max_sessions = 2000;
  options_.expire_after = absl::Hours(1);
  for (const int sessions : {1000, 100}) {  // in memory, then on a disk
    Start();
    for (int i = 0; i < sessions; ++i) {
      const OpenedSession opened = Open("base");
      if (i % 2 == 0) {
        ASSERT_TRUE(registry_->Close(opened.id).ok());
      }
    }
    EXPECT_EQ(registry_->open_sessions(), sessions / 2);
    clock_.Advance(absl::ToInt64Nanoseconds(absl::Hours(1)));
    registry_->ExpireUnused();
    EXPECT_EQ(registry_->open_sessions(), 0);
    EXPECT_EQ(rig_.policy.use_count(), 1) << "no session is left";
    Durable();
  }
  EXPECT_EQ(Folders(), 0);
}

TEST_F(RegistryTest, AnAdapterThatWasImportedIsSomethingToKeep) {
  Durable();
  options_.max_sessions = 1;
  options_.max_stored_sessions = 4;  // three of them one client's
  Start();
  AdaptationState state = StateOf(rig_, *Open().session);
  state.lora.phi.version = 1;  // as a PEFT adapter comes
  const std::string file = *SerializeAdaptationState(state, rig_.policy->lora_targets());
  clock_.Advance(absl::ToInt64Nanoseconds(options_.abandoned_after));
  const OpenedSession opened = Open();
  ASSERT_TRUE(opened.session->Import(file).ok());
  for (int i = 0; i < 4; ++i) {
    clock_.Advance(absl::ToInt64Nanoseconds(2 * options_.abandoned_after));
    Client client(Open().session);
    client.StartEpisode(0, 0);
    client.Predict();
  }
  clock_.Advance(absl::ToInt64Nanoseconds(2 * options_.abandoned_after));
  const auto resumed = registry_->Resume(opened.id, opened.token);
  ASSERT_TRUE(resumed.ok()) << resumed.status();
  EXPECT_EQ(resumed->session->Position().updates_applied, 1u);
}

TEST_F(RegistryTest, APolicyThatDoesNotFitIsTheServersFaultAndTheSessionWaits) {
  struct Rigid : FakePolicy {
    Rigid() : FakePolicy("other-hash"), spec_(FakePolicy::spec()) { spec_.adaptable = false; }
    const PolicySpec& spec() const override { return spec_; }
    PolicySpec spec_;
  };
  Durable();
  Start();
  const OpenedSession opened = Open();
  Client client(opened.session);
  client.StartEpisode(0, 0);
  client.RunChunks(40);
  const std::shared_ptr<FakePolicy> right = rig_.policy;
  rig_.policy = std::make_shared<Rigid>();
  Start();
  const absl::Status refused = registry_->Resume(opened.id, opened.token).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(refused.message()), HasSubstr("start the server with the weights"));
  rig_.policy = right;
  EXPECT_TRUE(registry_->Resume(opened.id, opened.token).ok()) << "on the same server";
  Start();
  const auto resumed = registry_->Resume(opened.id, opened.token);
  ASSERT_TRUE(resumed.ok()) << resumed.status();
  EXPECT_EQ(resumed->session->Position().feedback_sequence, 40u);
}

TEST_F(RegistryTest, AFolderThatCannotBeReadIsListedAndHarmsNoOther) {
  Durable();
  Start();
  const OpenedSession good = Open(), bad = Open();
  fs::resize_file(folder_ + "/" + bad.id + "/journal-000000", 10);
  fs::create_directories(folder_ + "/closed-session-1");
  Start();
  EXPECT_FALSE(fs::exists(folder_ + "/closed-session-1"));
  EXPECT_TRUE(registry_->Resume(good.id, good.token).ok());
  EXPECT_FALSE(registry_->Resume(bad.id, bad.token).ok());
  const std::vector<SessionRow> rows = registry_->List();
  ASSERT_EQ(rows.size(), 2u);
  for (const SessionRow& row : rows) {
    EXPECT_EQ(row.error.ok(), row.id == good.id) << row.error;
    EXPECT_EQ(row.open, row.id == good.id);
  }
}

TEST_F(RegistryTest, AnOperatorListsVersionsPinsExportsAndRollsBackASessionOnDisk) {
  Durable();
  Start();
  const OpenedSession opened = Open();
  Client client(opened.session);
  client.StartEpisode(0, 0);
  client.RunChunks(56);
  Start();
  const auto session = registry_->Load(opened.id);
  ASSERT_TRUE(session.ok()) << session.status();
  const auto versions = (*session)->Versions();
  ASSERT_EQ(versions->size(), 5u);
  for (size_t i = 0; i < 5; ++i) EXPECT_EQ((*versions)[i].weights->version, i);
  EXPECT_EQ((*versions)[2].feedback_sequence, 40u);
  EXPECT_GT((*versions)[2].distance, (*versions)[1].distance);
  ASSERT_TRUE((*session)->Pin(4, true).ok());
  EXPECT_THAT(std::string((*session)->Rollback(2).message()), HasSubstr("version 4 is pinned"));
  ASSERT_TRUE((*session)->Pin(4, false).ok());
  const std::string exported = *(*session)->ExportVersion(2);
  ASSERT_TRUE((*session)->Rollback(2).ok());
  EXPECT_EQ(ExportOf(**session), exported) << "what a rollback leaves is what was exported";
  EXPECT_EQ((*session)->ExportVersion(4).status().code(), absl::StatusCode::kNotFound);
  EXPECT_TRUE(rig_.Open(Spec("ours", {"learning_rate=0.01"}))->Import(exported).ok());
}

}  // namespace
}  // namespace robostress
