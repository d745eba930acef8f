#include "common/wire/openpi_connection.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/wire/openpi_readers.h"
#include "tests/common/wire/openpi_bytes.h"
#include "tests/common/wire/scripted_peer.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

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
  EXPECT_EQ(*(*connection)->Ask("a"), "a!");
  EXPECT_EQ(*(*connection)->Ask("b"), "b!");
  const absl::Status failed = (*connection)->Ask("c").status();
  EXPECT_EQ(failed.code(), absl::StatusCode::kInternal);
  EXPECT_EQ(failed.message(),
            (*connection)->address() + ": the policy server failed: ValueError: no gripper");
}

TEST(OpenpiConnection, GivesOnlyTheFirstAnswerTimeToCompile) {
  const ScriptedPeer server = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Write(web, OpenpiBytes().Map(0).bytes());
    ScriptedPeer::Read(web);
    std::this_thread::sleep_for(std::chrono::milliseconds(500));
    ScriptedPeer::Write(web, "compiled");
    ScriptedPeer::AwaitEnd(web);
  });
  OpenpiConnectionOptions options;
  options.first_answer_timeout = absl::Seconds(30);
  options.answer_timeout = absl::Milliseconds(100);
  const auto connection = OpenpiConnection::Connect(server.url(), options);
  ASSERT_TRUE(connection.ok()) << connection.status();
  EXPECT_EQ(*(*connection)->Ask("a"), "compiled");
  EXPECT_EQ((*connection)->Ask("b").status().code(), absl::StatusCode::kDeadlineExceeded);
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

}  // namespace
}  // namespace robostress
