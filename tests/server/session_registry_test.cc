#include "server/session_registry.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>

#include "absl/strings/str_cat.h"
#include "tests/server/drive.h"

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
    if (registry.ok()) registry_ = *std::move(registry);
    return registry.status();
  }
  void Start() {
    const absl::Status status = TryStart();
    ASSERT_TRUE(status.ok()) << status;
  }
  void Durable() { options_.state_dir = folder_; }
  OpenedSession Open(const std::string& method = "ours") {
    auto opened = registry_->Open({Spec(method, {"learning_rate=0.01"}), {}, {}});
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

TEST_F(RegistryTest, WritesTheSessionUnusedForLongestToDiskToMakeRoom) {
  Durable();
  Start();
  const OpenedSession first = Open();
  Client client(first.session);
  client.StartEpisode(0, 0);
  client.RunChunks(33);
  const std::string before = ExportOf(*first.session);
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Minutes(1)));
  Open();
  Open();
  EXPECT_EQ(registry_->Open({Spec("ours"), {}, {}}).status().code(),
            absl::StatusCode::kResourceExhausted);
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Minutes(14)));
  Open();
  EXPECT_EQ(registry_->open_sessions(), 3);
  EXPECT_FALSE(registry_->Use(first.id).ok());
  EXPECT_EQ(Folders(), 4);
  clock_.Advance(absl::ToInt64Nanoseconds(absl::Minutes(15)));
  const auto resumed = registry_->Resume(first.id, first.token);
  ASSERT_TRUE(resumed.ok()) << resumed.status();
  EXPECT_EQ(ExportOf(*resumed->session), before);
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
