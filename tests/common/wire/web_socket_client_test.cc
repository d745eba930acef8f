#include "common/wire/web_socket_client.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <boost/asio/write.hpp>
#include <memory>
#include <string>
#include <vector>

#include "absl/strings/str_cat.h"
#include "absl/synchronization/notification.h"
#include "absl/time/clock.h"
#include "server/wire/web/web_server.h"
#include "tests/common/wire/scripted_peer.h"
#include "tests/server/operations/test_certificates.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

// What is refused, and how.
std::string Refusal(absl::StatusCode code, const std::string& url,
                    const WebSocketOptions& options = {}) {
  const auto client = WebSocketClient::Connect(url, options);
  EXPECT_EQ(client.status().code(), code) << client.status();
  return std::string(client.status().message());
}
WebSocketOptions Hasty() {
  WebSocketOptions options;
  options.connect_timeout = absl::Milliseconds(1500);
  return options;
}

TEST(WebSocketClient, TalksAndSaysGoodbye) {
  uint16_t code = 0;
  {
    const ScriptedPeer peer = ScriptedPeer::WebSocket([&](ScriptedPeer::Socket& web) {
      ScriptedPeer::Write(web, "hello");
      for (int i = 0; i < 3; ++i) ScriptedPeer::Write(web, ScriptedPeer::Read(web) + "!");
      ScriptedPeer::AwaitEnd(web);
      code = web.reason().code;
    });
    const auto client = WebSocketClient::Connect(peer.url());
    ASSERT_TRUE(client.ok()) << client.status();
    EXPECT_EQ((*client)->address(), peer.url() + "/");
    EXPECT_EQ((*client)->Receive(absl::Seconds(10))->bytes, "hello");
    // Longer than what is masked at a time.
    for (const std::string& sent : {std::string("a"), std::string(), std::string(200000, 'x')}) {
      ASSERT_TRUE((*client)->Send(sent).ok());
      const auto answer = (*client)->Receive(absl::Seconds(10));
      ASSERT_TRUE(answer.ok()) << answer.status();
      EXPECT_FALSE(answer->text);
      EXPECT_EQ(answer->bytes, sent + "!");
    }
    EXPECT_EQ((*client)->close_code(), 0);
  }
  EXPECT_EQ(code, 1000);
}

TEST(WebSocketClient, AnswersPingsWhileNobodyAsks) {
  int pongs = 0;
  const ScriptedPeer peer = ScriptedPeer::WebSocket([&](ScriptedPeer::Socket& web) {
    web.control_callback([&](boost::beast::websocket::frame_type kind, boost::beast::string_view) {
      pongs += kind == boost::beast::websocket::frame_type::pong;
    });
    for (int i = 0; i < 3; ++i) web.ping({});
    ScriptedPeer::Write(web, ScriptedPeer::Read(web));  // reads the pongs before the message
    ScriptedPeer::AwaitEnd(web);
  });
  auto client = WebSocketClient::Connect(peer.url());
  ASSERT_TRUE(client.ok()) << client.status();
  absl::SleepFor(absl::Milliseconds(300));  // the simulator works
  ASSERT_TRUE((*client)->Send("question").ok());
  ASSERT_TRUE((*client)->Receive(absl::Seconds(10)).ok());
  EXPECT_EQ(pongs, 3);
}

TEST(WebSocketClient, SaysWhoIsNotThere) {
  std::string url;
  {
    const ScriptedPeer gone([](ScriptedPeer::Tcp::socket) {});
    url = gone.url();
  }
  EXPECT_THAT(Refusal(absl::StatusCode::kUnavailable, url),
              AllOf(HasSubstr(url), HasSubstr("Connection refused"),
                    HasSubstr("start the policy server there, or correct the port")));
  EXPECT_THAT(Refusal(absl::StatusCode::kInvalidArgument, "http://a:1"), HasSubstr("ws://"));
}

TEST(WebSocketClient, KnowsAServerThatSpeaksSomethingElse) {
  const auto answering = [](const std::string& answer) {
    return ScriptedPeer([answer](ScriptedPeer::Tcp::socket socket) {
      ScriptedPeer::Error error;
      char request[4096];
      socket.read_some(boost::asio::buffer(request), error);
      boost::asio::write(socket, boost::asio::buffer(answer), error);
      socket.shutdown(ScriptedPeer::Tcp::socket::shutdown_send, error);
      while (!error) socket.read_some(boost::asio::buffer(request), error);
    });
  };
  const ScriptedPeer ssh = answering("SSH-2.0-OpenSSH\r\n");
  EXPECT_THAT(Refusal(absl::StatusCode::kUnavailable, ssh.url()),
              AllOf(HasSubstr("speaks no WebSocket"), HasSubstr("is it a policy server's port?")));
  const ScriptedPeer page = answering("HTTP/1.1 200 OK\r\nContent-Length: 5\r\n\r\nhello");
  EXPECT_THAT(Refusal(absl::StatusCode::kUnavailable, page.url()),
              HasSubstr("answers HTTP 200 to a WebSocket: hello"));
  const ScriptedPeer path = answering("HTTP/1.1 404 Not Found\r\nContent-Length: 0\r\n\r\n");
  EXPECT_THAT(Refusal(absl::StatusCode::kNotFound, path.url() + "/x"),
              AllOf(HasSubstr("/x answers HTTP 404"), HasSubstr("check the path")));
  const ScriptedPeer liar = answering(
      "HTTP/1.1 101 Switching Protocols\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
      "Sec-WebSocket-Accept: s3pPLMBiTxaQ9kYGzzhZRbK+xOo=\r\n\r\n");
  EXPECT_FALSE(WebSocketClient::Connect(liar.url()).ok());
}

TEST(WebSocketClient, WaitsNoLongerThanItWasTold) {
  const ScriptedPeer silent([](ScriptedPeer::Tcp::socket socket) {
    ScriptedPeer::Error error;
    char request[4096];
    while (!error) socket.read_some(boost::asio::buffer(request), error);
  });
  const absl::Time begin = absl::Now();
  EXPECT_THAT(Refusal(absl::StatusCode::kDeadlineExceeded, silent.url(), Hasty()),
              HasSubstr("not open within 1.5s, while the WebSocket is asked for"));
  EXPECT_LT(absl::Now() - begin, absl::Seconds(8));

  const ScriptedPeer busy =
      ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) { ScriptedPeer::AwaitEnd(web); });
  auto client = WebSocketClient::Connect(busy.url());
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->Send("question").ok());
  const absl::Status late = (*client)->Receive(absl::Milliseconds(100)).status();
  EXPECT_EQ(late.code(), absl::StatusCode::kDeadlineExceeded);
  EXPECT_THAT(std::string(late.message()), HasSubstr("does not answer within 100ms"));
  // A late answer must not be taken for the next question's.
  EXPECT_EQ((*client)->Send("another"), late);
  EXPECT_EQ((*client)->Receive(absl::Seconds(1)).status(), late);
}

TEST(WebSocketClient, CutsAPeerThatTakesNothing) {
  absl::Notification over;
  const ScriptedPeer deaf =
      ScriptedPeer::WebSocket([&over](ScriptedPeer::Socket&) { over.WaitForNotification(); });
  WebSocketOptions options;
  options.send_timeout = absl::Milliseconds(200);
  auto client = WebSocketClient::Connect(deaf.url(), options);
  EXPECT_TRUE(client.ok()) << client.status();
  if (!client.ok()) return over.Notify();
  const absl::Status sent = (*client)->Send(std::string(64 << 20, 'x'));
  EXPECT_EQ(sent.code(), absl::StatusCode::kDeadlineExceeded) << sent;
  EXPECT_THAT(std::string(sent.message()), HasSubstr("takes nothing for 200ms"));
  over.Notify();
}

TEST(WebSocketClient, RefusesMoreThanItAskedFor) {
  const auto connect = [](const ScriptedPeer& peer) {
    WebSocketOptions options;
    options.max_message_bytes = 1000;
    return *WebSocketClient::Connect(peer.url(), options);
  };
  const ScriptedPeer large = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Write(web, std::string(1001, 'x'));
    ScriptedPeer::AwaitEnd(web);
  });
  const absl::Status refused = connect(large)->Receive(absl::Seconds(10)).status();
  EXPECT_EQ(refused.code(), absl::StatusCode::kResourceExhausted) << refused;
  EXPECT_THAT(std::string(refused.message()), HasSubstr("a message of more than 1000 bytes"));

  const ScriptedPeer talker = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    for (int i = 0; i < 100; ++i) ScriptedPeer::Write(web, "x");
    ScriptedPeer::AwaitEnd(web);
  });
  const auto client = connect(talker);
  absl::Status last;
  int messages = 0;
  while (client->Send("").ok()) absl::SleepFor(absl::Milliseconds(10));  // nobody reads meanwhile
  while (last.ok()) {
    last = client->Receive(absl::Seconds(10)).status();
    messages += last.ok();
  }
  EXPECT_EQ(last.code(), absl::StatusCode::kResourceExhausted) << last;
  EXPECT_LT(messages, 20);
}

TEST(WebSocketClient, TellsTextFromBinaryAndHowItWasClosed) {
  const ScriptedPeer failing = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    web.text(true);
    ScriptedPeer::Write(web, "Traceback");
    ScriptedPeer::Error ignored;
    web.close({boost::beast::websocket::close_code::internal_error, "see above"}, ignored);
  });
  auto client = WebSocketClient::Connect(failing.url());
  ASSERT_TRUE(client.ok()) << client.status();
  const auto text = (*client)->Receive(absl::Seconds(10));
  ASSERT_TRUE(text.ok()) << text.status();
  EXPECT_TRUE(text->text);
  EXPECT_EQ(text->bytes, "Traceback");
  const absl::Status closed = (*client)->Receive(absl::Seconds(10)).status();
  EXPECT_EQ(closed.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(closed.message()), HasSubstr("closed with 1011: see above"));
  EXPECT_EQ((*client)->close_code(), 1011);
}

TEST(WebSocketClient, SeesAPeerThatVanishes) {
  const ScriptedPeer vanishing = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Read(web);
    ScriptedPeer::Error ignored;
    web.next_layer().close(ignored);
  });
  auto client = WebSocketClient::Connect(vanishing.url());
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_TRUE((*client)->Send("question").ok());
  const absl::Status lost = (*client)->Receive(absl::Seconds(10)).status();
  EXPECT_EQ(lost.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(lost.message()), AllOf(HasSubstr("lost: "), HasSubstr("connect again")));
}

class Echo : public WebConversation {
 public:
  std::string Greeting() override { return "hello"; }
  uint64_t LargestMessage() const override { return 1000; }
  absl::StatusOr<std::string> Answer(std::string_view message) override {
    return std::string(message);
  }
};

// Our own server, plain or with TLS, which wants a header and takes who has it.
class SecuredServer : public ::testing::Test {
 protected:
  void Start(std::shared_ptr<const TlsStore> tls, const std::string& authorization) {
    WebServerOptions options;
    options.listen = "0.0.0.0:0";
    options.tls = std::move(tls);
    auto server = WebServer::Start(
        options, [](const WebRequest&) { return WebReply(); },
        [authorization](
            const WebRequest& request) -> absl::StatusOr<std::unique_ptr<WebConversation>> {
          if (request.authorization != authorization)
            return absl::UnauthenticatedError("who are you?");
          return std::make_unique<Echo>();
        },
        &metrics_);
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
  }
  std::string url(const std::string& scheme, const std::string& host = "127.0.0.1") const {
    return absl::StrCat(scheme, "://", host, ":", server_->port());
  }

  Metrics metrics_;
  std::unique_ptr<WebServer> server_;
};

TEST_F(SecuredServer, ShowsItsTokenAndNothingBreaksAHeader) {
  Start(nullptr, "Api-Key secret");
  WebSocketOptions options;
  EXPECT_THAT(
      Refusal(absl::StatusCode::kUnauthenticated, url("ws")),
      AllOf(HasSubstr("HTTP 401"), HasSubstr("who are you?"), HasSubstr("ROBOSTRESS_TOKEN_FILE")));
  options.secrets.token = "secret";
  EXPECT_TRUE(WebSocketClient::Connect(url("ws"), options).ok());
  options.token_scheme = "Bearer";
  EXPECT_FALSE(WebSocketClient::Connect(url("ws"), options).ok());
  options.secrets.token = "secret\r\nX-Other: 1";
  EXPECT_THAT(Refusal(absl::StatusCode::kInvalidArgument, url("ws"), options),
              HasSubstr("is it the right file?"));
}

TEST_F(SecuredServer, TrustsTheAuthorityItWasGivenAndTheNameInTheCertificate) {
  const TestCertificates certificates;
  certificates.MakeAuthority("ca");
  certificates.MakeAuthority("other");
  certificates.Make("server", "ca");
  certificates.Make("client", "ca");
  Start(*LoadTls(certificates.Files("server", "ca")), "");
  WebSocketOptions options;
  options.secrets.authority = certificates.Read("ca.crt");
  options.secrets.certificate = certificates.Read("client.crt");
  options.secrets.key = certificates.Read("client.key");
  auto client = WebSocketClient::Connect(url("wss"), options);
  ASSERT_TRUE(client.ok()) << client.status();
  ASSERT_EQ((*client)->Receive(absl::Seconds(10))->bytes, "hello");
  ASSERT_TRUE((*client)->Send("secret").ok());
  EXPECT_EQ((*client)->Receive(absl::Seconds(10))->bytes, "secret");

  WebSocketOptions other = options;
  other.secrets.authority = certificates.Read("other.crt");
  EXPECT_THAT(Refusal(absl::StatusCode::kUnavailable, url("wss"), other),
              AllOf(HasSubstr("TLS: "), HasSubstr("ROBOSTRESS_TLS_CA")));
  // Its certificate is 127.0.0.1's.
  EXPECT_THAT(Refusal(absl::StatusCode::kUnavailable, url("wss", "localhost"), options),
              HasSubstr("mismatch"));
  EXPECT_THAT(Refusal(absl::StatusCode::kUnavailable, url("wss", "127.0.0.2"), options),
              HasSubstr("mismatch"));
  EXPECT_THAT(Refusal(absl::StatusCode::kUnavailable, url("ws")), HasSubstr("127.0.0.1"));
  WebSocketOptions anonymous = options;
  anonymous.secrets.certificate = anonymous.secrets.key = "";
  EXPECT_FALSE(WebSocketClient::Connect(url("wss"), anonymous).ok());
  other = options;
  other.secrets.key = certificates.Read("server.key");
  EXPECT_THAT(Refusal(absl::StatusCode::kInvalidArgument, url("wss"), other),
              HasSubstr("TLS client key: is not the key of"));
}

}  // namespace
}  // namespace robostress
