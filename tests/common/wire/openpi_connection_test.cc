#include "common/wire/openpi_connection.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "absl/time/clock.h"
#include "absl/time/time.h"
#include "common/wire/openpi_readers.h"
#include "tests/common/wire/heard_log.h"
#include "tests/common/wire/openpi_bytes.h"
#include "tests/common/wire/scripted_peer.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr absl::Duration kLong = absl::Seconds(10);

TEST(OpenpiConnection, ReadsMetadataThenAnswersInTurn) {
  const ScriptedPeer server = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    OpenpiBytes metadata;
    metadata.Map(1).Text("reset_pose").Numbers<float>("<f4", {2}, {1, 2});
    ScriptedPeer::Write(web, metadata.bytes());
    for (int i = 0; i < 2; ++i) ScriptedPeer::Write(web, ScriptedPeer::Read(web) + "!");
    web.text(true);
    ScriptedPeer::Read(web);
    ScriptedPeer::Write(web, "Traceback:\nValueError: no gripper");
    ScriptedPeer::AwaitEnd(web);
  });
  const auto connection = OpenpiConnection::Connect(server.url());
  ASSERT_TRUE(connection.ok()) << connection.status();
  EXPECT_EQ(OpenpiCount(*(*connection)->metadata().Find("reset_pose")), 2u);
  EXPECT_EQ(*(*connection)->Ask("a", kLong), "a!");
  EXPECT_EQ(*(*connection)->Ask("b", kLong), "b!");
  const absl::Status failed = (*connection)->Ask("c", kLong).status();
  EXPECT_EQ(failed.code(), absl::StatusCode::kInternal);
  EXPECT_EQ(failed.message(),
            (*connection)->address() + ": the policy server failed: ValueError: no gripper");
}

TEST(OpenpiConnection, TrustsNoAnswerAfterOneThatNobodyAskedFor) {
  const ScriptedPeer server = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Write(web, OpenpiBytes().Map(0).bytes());
    ScriptedPeer::Read(web);
    for (const char* answer : {"first", "more"}) ScriptedPeer::Write(web, answer);
    ScriptedPeer::AwaitEnd(web);
  });
  const auto connection = OpenpiConnection::Connect(server.url());
  ASSERT_TRUE(connection.ok()) << connection.status();
  EXPECT_EQ(*(*connection)->Ask("a", kLong), "first");
  absl::SleepFor(absl::Milliseconds(100));
  const absl::Status shifted = (*connection)->Ask("b", kLong).status();
  EXPECT_EQ(shifted.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(shifted.message()), HasSubstr("4 bytes that nobody asked for"));
}

TEST(OpenpiConnection, AServersLastWordBetweenQuestionsEndsTheConnectionAlone) {
  const ScriptedPeer server = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Write(web, OpenpiBytes().Map(0).bytes());
    web.text(true);
    ScriptedPeer::Write(web, "Traceback:\nTimeout: idle");
    ScriptedPeer::AwaitEnd(web);
  });
  const auto connection = OpenpiConnection::Connect(server.url());
  ASSERT_TRUE(connection.ok()) << connection.status();
  absl::SleepFor(absl::Milliseconds(100));
  const absl::Status ended = (*connection)->Ask("a", kLong).status();
  EXPECT_EQ(ended.code(), absl::StatusCode::kUnavailable) << "a new connection may do";
  EXPECT_THAT(std::string(ended.message()), HasSubstr("Timeout: idle"));
}

TEST(OpenpiConnection, KnowsAServerThatIsNotOpenpis) {
  const ScriptedPeer chat = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Write(web, "\xc1welcome");
    ScriptedPeer::AwaitEnd(web);
  });
  const absl::Status refused = OpenpiConnection::Connect(chat.url()).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(refused.message()), AllOf(HasSubstr("greets without openpi's metadata"),
                                                    HasSubstr("is it a policy server's port?")));
  const ScriptedPeer silent =
      ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) { ScriptedPeer::AwaitEnd(web); });
  OpenpiConnectionOptions options;
  options.metadata_timeout = absl::Milliseconds(100);
  EXPECT_EQ(OpenpiConnection::Connect(silent.url(), options).status().code(),
            absl::StatusCode::kDeadlineExceeded);
}

TEST(OpenpiConnection, SaysEarlyWhatAServerMayBeThatDoesNotGreet) {
  const ScriptedPeer late = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    absl::SleepFor(absl::Milliseconds(300));
    ScriptedPeer::Write(web, OpenpiBytes().Map(0).bytes());
    ScriptedPeer::AwaitEnd(web);
  });
  OpenpiConnectionOptions options;
  EXPECT_EQ(options.silence, absl::Seconds(5));
  options.silence = absl::Milliseconds(50);
  {
    const HeardLog log;
    const auto connection = OpenpiConnection::Connect(late.url(), options);
    EXPECT_TRUE(connection.ok()) << "it is not given up: " << connection.status();
    EXPECT_THAT(log.words(), HasSubstr(late.url() + "/ has said nothing for 50ms; if it is "
                                                    "vla-eval's, choose --dialect vla_eval"));
  }
  const ScriptedPeer prompt = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Write(web, OpenpiBytes().Map(0).bytes());
    ScriptedPeer::AwaitEnd(web);
  });
  options.silence = absl::Seconds(5);
  const HeardLog log;
  EXPECT_TRUE(OpenpiConnection::Connect(prompt.url(), options).ok());
  EXPECT_EQ(log.words(), "");
}

}  // namespace
}  // namespace robostress
