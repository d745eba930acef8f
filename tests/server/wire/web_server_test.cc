// What a connection costs the server: threads, workers, places; with a conversation that waits when
// it is told to.
#include "server/wire/web/web_server.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <filesystem>
#include <iterator>
#include <memory>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "absl/synchronization/notification.h"
#include "tests/server/wire/web_client.h"

namespace robostress {
namespace {

using ::testing::EndsWith;

int Threads() {
  const std::filesystem::directory_iterator tasks("/proc/self/task");
  return static_cast<int>(std::distance(begin(tasks), end(tasks)));
}

class WebServerTest : public ::testing::Test {
 protected:
  // "wait": until `release`; "big": a reply of 1 MB; anything else: itself.
  class Conversation : public WebConversation {
   public:
    Conversation(WebServerTest& test, std::string client)
        : test_(test), client_(std::move(client)) {
      ++test_.conversations_;
    }
    ~Conversation() override {
      test_.last_end_ = std::this_thread::get_id();
      --test_.conversations_;
    }
    std::string Greeting() override { return "hello"; }
    uint64_t LargestMessage() const override { return 1000; }
    std::string client() const override { return client_; }
    absl::StatusOr<std::string> Answer(std::string_view message) override {
      test_.last_answer_ = std::this_thread::get_id();
      ++test_.begun_;
      if (message == "wait") test_.release_.WaitForNotification();
      if (message == "late") test_.release_.WaitForNotificationWithTimeout(absl::Milliseconds(900));
      ++test_.answered_;
      return message == "big" ? std::string(1 << 20, 'x') : std::string(message);
    }

   private:
    WebServerTest& test_;
    const std::string client_;
  };

  ~WebServerTest() override {
    if (!release_.HasBeenNotified()) release_.Notify();
  }

  void Start(const WebServerOptions& options) {
    auto server = WebServer::Start(
        options,
        [this](const WebRequest& request) -> WebReply {
          if (request.path == "/wait") {
            ++begun_;
            release_.WaitForNotification();
          }
          return {200, "text/plain", request.path};
        },
        [this](const WebRequest& request) -> absl::StatusOr<std::unique_ptr<WebConversation>> {
          return std::make_unique<Conversation>(*this, request.authorization);
        },
        &metrics_);
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
  }
  // As `client`; it has read the greeting.
  std::unique_ptr<WebClient> Connect(const std::string& client = "somebody") {
    auto connected = std::make_unique<WebClient>(server_->port());
    EXPECT_EQ(connected->Upgrade("Authorization: " + client + "\r\n"), 101);
    EXPECT_EQ(connected->Read().payload, "hello");
    return connected;
  }
  static std::string Ask(WebClient& client, const std::string& message) {
    client.SendFrame(message);
    return client.Read().payload;
  }
  template <class Condition>
  static void Await(Condition condition) {
    for (int i = 0; i < 2000 && !condition(); ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    EXPECT_TRUE(condition());
  }

  Metrics metrics_;
  absl::Notification release_;
  std::atomic<int> conversations_{0}, begun_{0}, answered_{0};
  std::atomic<std::thread::id> last_end_, last_answer_;
  std::unique_ptr<WebServer> server_;
};

TEST_F(WebServerTest, IdleConnectionsTakeNoThread) {
  WebServerOptions options;
  options.max_connections = options.max_connections_per_client = 320;
  Start(options);
  std::vector<std::unique_ptr<WebClient>> clients;
  clients.push_back(Connect());
  EXPECT_EQ(Ask(*clients.back(), "a"), "a");
  const int before = Threads();
  for (int i = 0; i < 299; ++i) clients.push_back(Connect());
  EXPECT_EQ(server_->connections(), 300);
  EXPECT_LE(Threads(), before + 3) << "workers are made when some meet; connections make none";
  for (const auto& client : clients) ASSERT_EQ(Ask(*client, "b"), "b");
  clients.clear();  // all at once
  Await([this] { return server_->connections() == 0; });
  EXPECT_LE(Threads(), before + 3);
}

TEST_F(WebServerTest, SilentHandshakesTakeNoThread) {
  WebServerOptions options;
  options.max_connections = options.max_connections_per_client = 120;
  Start(options);
  const int before = Threads();
  std::vector<std::unique_ptr<WebClient>> silent;
  for (int i = 0; i < 100; ++i) silent.push_back(std::make_unique<WebClient>(server_->port()));
  Await([this] { return server_->connections() == 100; });
  EXPECT_EQ(Threads(), before);
}

TEST_F(WebServerTest, AReaderThatDoesNotReadHoldsNoWorker) {
  WebServerOptions options;
  options.workers = 1;
  Start(options);
  const auto silent = Connect();
  for (int i = 0; i < 40; ++i) silent->SendFrame("big");
  // More than the sockets hold: its last answer waits to be taken, and the next message is not
  // read.
  int answered = -1;
  Await(
      [this, &answered] { return std::exchange(answered, answered_) == answered && answered > 2; });
  EXPECT_LT(answered_, 40);
  const auto other = Connect("other");
  EXPECT_EQ(Ask(*other, "a"), "a");
}

TEST_F(WebServerTest, AConnectionThatIsCutWhileItsMessageIsInWorkLeavesNothing) {
  Start({});
  auto client = Connect();
  client->SendFrame("wait");
  Await([this] { return begun_ == 1; });
  client->Close();
  EXPECT_EQ(conversations_, 1);  // it is in use
  release_.Notify();
  Await([this] { return server_->connections() == 0; });
  EXPECT_EQ(conversations_, 0);
  EXPECT_EQ(answered_, 1);
  EXPECT_NE(last_end_.load(), std::thread::id());
}

TEST_F(WebServerTest, ConversationsAnswerAndEndOnWorkers) {
  WebServerOptions options;
  options.workers = 1;
  Start(options);
  auto client = Connect();
  EXPECT_EQ(Ask(*client, "a"), "a");
  client->Close();
  Await([this] { return server_->connections() == 0; });
  EXPECT_EQ(last_end_.load(), last_answer_.load());
}

TEST_F(WebServerTest, AnAnswerMayTakeLongerThanAPeerMayBeSilent) {
  WebServerOptions options;
  options.idle_timeout = absl::Milliseconds(300);
  Start(options);
  const auto client = Connect();
  client->SendFrame("late");
  WebClient::Frame frame = client->Read();
  while (frame.opcode == WebClient::kPing) frame = client->Read();
  EXPECT_EQ(frame.payload, "late");
}

TEST_F(WebServerTest, AMessageThatWaitsLeavesWorkersToOthers) {
  WebServerOptions options;
  options.workers = 4;
  Start(options);
  std::vector<std::unique_ptr<WebClient>> waiting;
  for (int i = 0; i < 6; ++i) {
    waiting.push_back(Connect("greedy"));
    waiting.back()->SendFrame("wait");
  }
  Await([this] { return begun_ == 3; });  // three quarters of them
  const auto other = Connect("other");
  EXPECT_EQ(Ask(*other, "a"), "a");
  release_.Notify();
  for (const auto& client : waiting) EXPECT_EQ(client->Read().payload, "wait");
}

TEST_F(WebServerTest, AProbeIsAnsweredWhenAllWorkersAreTaken) {
  WebServerOptions options;
  options.workers = 1;
  Start(options);
  WebClient page(server_->port());
  page.Send("GET /wait HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n");
  Await([this] { return begun_ == 1; });
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz").first, 200);
  release_.Notify();
  EXPECT_THAT(page.Receive(SIZE_MAX), EndsWith("/wait"));
}

TEST_F(WebServerTest, StopSendsTheAnswerThatIsUnderWay) {
  Start({});
  const auto client = Connect();
  client->SendFrame("wait");
  Await([this] { return begun_ == 1; });
  std::thread stopping([this] { server_->Stop(absl::Seconds(20)); });
  release_.Notify();
  EXPECT_EQ(client->Read().payload, "wait");
  const WebClient::Frame close = client->Read();
  EXPECT_EQ(close.close_code(), 1001);
  client->SendFrame(close.payload, WebClient::kClose);
  EXPECT_EQ(client->Read().opcode, -1);
  client->Close();
  stopping.join();
  EXPECT_EQ(conversations_, 0);
}

TEST_F(WebServerTest, StopCutsWhatIsNotReadyInTime) {
  Start({});
  const auto client = Connect(), silent = Connect();
  client->SendFrame("wait");
  Await([this] { return begun_ == 1; });
  std::thread stopping([this] { server_->Stop(absl::Milliseconds(50)); });
  EXPECT_EQ(client->Read().opcode, -1);  // cut before it is answered
  EXPECT_EQ(silent->Read().close_code(), 1001);
  release_.Notify();
  stopping.join();
  EXPECT_EQ(conversations_, 0);
}

TEST_F(WebServerTest, AStopAtAnyMomentLeavesNothing) {
  for (int i = 0; i < 30; ++i) {
    Start({});
    std::vector<std::unique_ptr<WebClient>> clients;
    for (int j = 0; j < i % 5 + 1; ++j) {
      clients.push_back(std::make_unique<WebClient>(server_->port()));
      clients.back()->Send(
          "GET / HTTP/1.1\r\nHost: localhost\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
          "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n" +
          WebClient::FrameBytes("a"));
    }
    server_->Stop(absl::ZeroDuration());
    EXPECT_EQ(conversations_, 0);
  }
}

}  // namespace
}  // namespace robostress
