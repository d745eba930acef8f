#include "server/proxy/relay.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <deque>
#include <memory>

#include "common/atomic_file.h"
#include "tests/common/wire/heard_log.h"
#include "tests/server/operations/test_certificates.h"
#include "tests/server/proxy/upstream.h"
#include "tests/server/wire/tls_web_client.h"
#include "tests/server/wire/web_client.h"

namespace robostress {
namespace {

using ::testing::HasSubstr;

RelayOptions To(const std::string& upstream) {
  RelayOptions options;
  options.listen = "127.0.0.1:0";
  options.upstream = upstream;
  options.probe_period = absl::Milliseconds(50);
  return options;
}

std::unique_ptr<Relay> Start(const RelayOptions& options, Relay::MakeTap tap = nullptr) {
  auto relay = Relay::Start(options, std::move(tap));
  EXPECT_TRUE(relay.ok()) << relay.status();
  return *std::move(relay);
}

// Whether it comes to `wanted` within ten seconds.
template <class Condition>
bool Comes(const Condition& wanted) {
  for (int i = 0; i < 1000 && !wanted(); ++i)
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  return wanted();
}
bool Appears(const Relay& relay) {
  return Comes([&] { return relay.figures().upstream_there; });
}

void Echo(Upstream::Socket& socket, const Upstream::Request&) {
  Upstream::Write(socket, "greeting");
  while (const auto message = Upstream::Read(socket))
    Upstream::Write(socket, message->bytes, message->text);
}

// Nobody listens.
bool Refused(int port) {
  const int fd = socket(AF_INET, SOCK_STREAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const bool refused = connect(fd, reinterpret_cast<sockaddr*>(&address), sizeof address) != 0 &&
                       errno == ECONNREFUSED;
  close(fd);
  return refused;
}

TEST(Relay, CarriesEveryMessageAsItIs) {
  const Upstream upstream(Echo);
  const auto relay = Start(To(upstream.url()));
  ASSERT_TRUE(Appears(*relay));
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  EXPECT_EQ(client.Read().payload, "greeting");
  std::string every(256, '\0');
  for (size_t i = 0; i < every.size(); ++i) every[i] = static_cast<char>(i);
  for (const size_t size : {size_t{0}, size_t{1}, size_t{125}, size_t{126}, size_t{65535},
                            size_t{65536}, size_t{300000}, size_t{16} << 20}) {
    std::string message;
    while (message.size() < size) message += every;
    message.resize(size);
    client.SendFrame(message);
    const WebClient::Frame frame = client.Read();
    EXPECT_EQ(frame.opcode, WebClient::kBinary);
    ASSERT_TRUE(frame.payload == message) << size;
  }
  client.SendFrame("words", WebClient::kText);
  const WebClient::Frame text = client.Read();
  EXPECT_EQ(text.opcode, WebClient::kText);
  EXPECT_EQ(text.payload, "words");
}

TEST(Relay, CarriesWhatNobodyAskedForAndPings) {
  std::atomic<int> pings{0};
  const Upstream upstream([&pings](Upstream::Socket& socket, const Upstream::Request&) {
    Upstream::Error ignored;
    socket.control_callback([&pings](boost::beast::websocket::frame_type kind, auto payload) {
      pings += kind == boost::beast::websocket::frame_type::ping && payload == "are you there";
    });
    Upstream::Write(socket, "one");
    Upstream::Write(socket, "two", true);
    socket.ping("and you", ignored);
    while (Upstream::Read(socket)) {
    }
  });
  const auto relay = Start(To(upstream.url()));
  ASSERT_TRUE(Appears(*relay));
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  EXPECT_EQ(client.Read().payload, "one");
  EXPECT_EQ(client.Read().payload, "two");
  const WebClient::Frame ping = client.Read();
  EXPECT_EQ(ping.opcode, WebClient::kPing);
  EXPECT_EQ(ping.payload, "and you");
  client.SendFrame("are you there", WebClient::kPing);
  EXPECT_EQ(client.Read().opcode, WebClient::kPong);
  EXPECT_TRUE(Comes([&] { return pings == 1; }));
}

TEST(Relay, CarriesCloseCodesBothWays) {
  std::atomic<int> code{0};
  const Upstream upstream([&code](Upstream::Socket& socket, const Upstream::Request&) {
    const auto message = Upstream::Read(socket);
    if (message && message->bytes == "fail") {
      Upstream::Error ignored;
      Upstream::Write(socket, "Traceback (most recent call last)", true);
      socket.close({boost::beast::websocket::close_code::internal_error, "why"}, ignored);
      return;
    }
    code = static_cast<int>(socket.reason().code);
  });
  const auto relay = Start(To(upstream.url()));
  ASSERT_TRUE(Appears(*relay));
  {
    WebClient client(relay->port());
    ASSERT_EQ(client.Upgrade(), 101);
    client.SendFrame("fail");
    const WebClient::Frame words = client.Read();
    EXPECT_EQ(words.opcode, WebClient::kText);
    EXPECT_EQ(words.payload, "Traceback (most recent call last)");
    const WebClient::Frame end = client.Read();
    EXPECT_EQ(end.opcode, WebClient::kClose);
    EXPECT_EQ(end.close_code(), 1011);
    EXPECT_EQ(end.payload.substr(2), "why");
  }
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  client.SendFrame(std::string("\x0f\xa1", 2), WebClient::kClose);  // 4001
  EXPECT_EQ(client.Read().close_code(), 4001);
  EXPECT_TRUE(Comes([&] { return code == 4001; })) << code;
}

TEST(Relay, PassesPathKeyAndSubProtocolAndTheServersRefusal) {
  std::string target, key, agent;
  const Upstream upstream([&](Upstream::Socket& socket, const Upstream::Request& request) {
    namespace http = boost::beast::http;
    const auto text = [](const auto& view) { return std::string(view.data(), view.size()); };
    target = text(request.target());
    key = text(request[http::field::authorization]);
    agent = text(request[http::field::user_agent]);
    Upstream::Write(socket, "greeting");
    Upstream::Read(socket);
  });
  {
    const auto relay = Start(To(upstream.url()));
    ASSERT_TRUE(Appears(*relay));
    WebClient client(relay->port());
    client.Send(
        "GET /openpi/policy?robot=1 HTTP/1.1\r\nHost: here\r\nUpgrade: websocket\r\nConnection: "
        "Upgrade\r\nUser-Agent: theirs\r\nAuthorization: Api-Key abc\r\n"
        "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n");
    std::string head;
    while (head.find("\r\n\r\n") == std::string::npos) {
      const std::string byte = client.Receive(1);
      ASSERT_FALSE(byte.empty()) << head;
      head += byte;
    }
    EXPECT_THAT(head, HasSubstr("101"));
    EXPECT_EQ(client.Read().payload, "greeting");
    EXPECT_TRUE(Comes([&] { return relay->figures().accepted == 1; }));
  }
  EXPECT_EQ(target, "/openpi/policy?robot=1");
  EXPECT_EQ(key, "Api-Key abc");
  EXPECT_EQ(agent, "theirs");
  const Upstream refusing([](Upstream::Socket&, const Upstream::Request&) {}, 0, 403);
  const auto relay = Start(To(refusing.url()));
  ASSERT_TRUE(Appears(*relay));
  WebClient client(relay->port());
  EXPECT_EQ(client.Upgrade(), 403);
}

TEST(Relay, RefusesClientsWhileNobodyListensUpstream) {
  int port = 0;
  {
    const Upstream gone(Echo);
    port = gone.port();
  }
  const auto relay = Start(To(absl::StrCat("ws://127.0.0.1:", port)));
  EXPECT_TRUE(Refused(relay->port())) << "openpi's client waits for this, and for nothing else";
  {
    const Upstream upstream(Echo, port);
    ASSERT_TRUE(Appears(*relay));
    WebClient client(relay->port());
    ASSERT_EQ(client.Upgrade(), 101);
    EXPECT_EQ(client.Read().payload, "greeting");
  }
  EXPECT_TRUE(Comes([&] { return Refused(relay->port()); }));
  EXPECT_FALSE(relay->figures().upstream_there);
  const Upstream back(Echo, port);
  ASSERT_TRUE(Appears(*relay)) << "on the same port as before";
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  EXPECT_EQ(client.Read().payload, "greeting");
}

TEST(Relay, AServerThatDiesEndsItsClientsWithoutAWord) {
  Upstream upstream(Echo);
  const auto relay = Start(To(upstream.url()));
  ASSERT_TRUE(Appears(*relay));
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  EXPECT_EQ(client.Read().payload, "greeting");
  upstream.CutAll();
  EXPECT_EQ(client.Read().opcode, -1);
  EXPECT_EQ(relay->figures().upstream_lost, 1u);
  EXPECT_TRUE(Comes([&] { return relay->figures().clients == 0; }));
}

TEST(Relay, AClientThatDiesEndsItsUpstreamConnection) {
  std::atomic<int> ended{0};
  const Upstream upstream([&ended](Upstream::Socket& socket, const Upstream::Request& request) {
    Echo(socket, request);
    ++ended;
  });
  const auto relay = Start(To(upstream.url()));
  ASSERT_TRUE(Appears(*relay));
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  client.Close();
  EXPECT_TRUE(Comes([&] { return ended == 1; }));
}

TEST(Relay, RefusesBrowsersStrangersAndTooManyClients) {
  const Upstream upstream(Echo);
  RelayOptions options = To(upstream.url());
  options.max_clients = 1;
  const auto relay = Start(options);
  ASSERT_TRUE(Appears(*relay));
  EXPECT_EQ(WebClient(relay->port()).Upgrade("Origin: http://elsewhere\r\n"), 403);
  EXPECT_TRUE(Comes([&] { return relay->figures().clients == 0; }));
  EXPECT_EQ(WebClient(relay->port()).Get("/healthz").first, 200);
  EXPECT_TRUE(Comes([&] { return relay->figures().clients == 0; }));
  EXPECT_EQ(WebClient(relay->port()).Get("/").first, 426);
  EXPECT_TRUE(Comes([&] { return relay->figures().clients == 0; }));
  WebClient first(relay->port());
  EXPECT_EQ(first.Upgrade(), 101);
  WebClient second(relay->port());
  EXPECT_EQ(second.Upgrade(), 0) << "the end";
  first.SendFrame("and still");
  EXPECT_EQ(first.Read().payload, "greeting");
  EXPECT_EQ(first.Read().payload, "and still");
}

TEST(Relay, TenThousandConnectionsThatSayNothingKeepNobodyOut) {
  const HeardLog log;  // before the relay's thread
  const Upstream upstream(Echo);
  RelayOptions options = To(upstream.url());
  options.max_clients = 4;
  const auto relay = Start(options);
  ASSERT_TRUE(Appears(*relay));
  WebClient before(relay->port());
  ASSERT_EQ(before.Upgrade(), 101);
  std::deque<std::unique_ptr<WebClient>> silent;
  for (int i = 0; i < 10000; ++i) {
    silent.push_back(std::make_unique<WebClient>(relay->port()));
    if (silent.size() > 200) silent.pop_front();
  }
  WebClient after(relay->port());
  ASSERT_EQ(after.Upgrade(), 101);
  for (WebClient* client : {&before, &after}) {
    EXPECT_EQ(client->Read().payload, "greeting");
    client->SendFrame("served");
    EXPECT_EQ(client->Read().payload, "served");
  }
  EXPECT_LE(relay->figures().clients, 5);
  const std::string words = log.words();
  EXPECT_LE(std::count(words.begin(), words.end(), '\n'), 5) << words;
}

TEST(Relay, SaysNowAndThenThatItIsFull) {
  const HeardLog log;  // before the relay's thread
  const Upstream upstream(Echo);
  RelayOptions options = To(upstream.url());
  options.max_clients = 1;
  const auto relay = Start(options);
  ASSERT_TRUE(Appears(*relay));
  WebClient one(relay->port());
  ASSERT_EQ(one.Upgrade(), 101);
  for (int i = 0; i < 500; ++i) EXPECT_EQ(WebClient(relay->port()).Upgrade(), 0);
  EXPECT_EQ(relay->figures().refused, 500u);
  const std::string words = log.words();
  EXPECT_THAT(words, HasSubstr("(--max-clients); 1 were refused so far"));
  EXPECT_LE(std::count(words.begin(), words.end(), '\n'), 5);
}

TEST(Relay, TellsWhoSendsMoreThanItTakes) {
  const Upstream upstream(Echo);
  RelayOptions options = To(upstream.url());
  options.max_message_bytes = 1000;
  const auto relay = Start(options);
  ASSERT_TRUE(Appears(*relay));
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  EXPECT_EQ(client.Read().payload, "greeting");
  client.SendFrame(std::string(1000, 'x'));
  EXPECT_EQ(client.Read().payload.size(), 1000u);
  client.SendFrame(std::string(1001, 'x'));
  EXPECT_EQ(client.Read().close_code(), 1009);
}

TEST(Relay, AsksForTlsAndTokensAndShowsItsOwn) {
  const TestCertificates files;
  files.MakeAuthority("ca");
  files.Make("near", "ca");
  std::string key;
  const Upstream upstream([&key](Upstream::Socket& socket, const Upstream::Request& request) {
    const auto shown = request[boost::beast::http::field::authorization];
    key = std::string(shown.data(), shown.size());
    Echo(socket, request);
  });
  RelayOptions options = To(upstream.url());
  auto tls = LoadTls(files.Files("near"));
  ASSERT_TRUE(tls.ok()) << tls.status();
  options.tls = *tls;
  options.tokens = std::make_shared<TokenStore>(*AccessTokens::Parse(
      "tokens", absl::StrCat("tokens:\n  - {name: arm, sha256: ", Sha256Hex("mine"),
                             ", scopes: [predict]}\n")));
  options.secrets.token = "theirs";
  const auto relay = Start(options);
  ASSERT_TRUE(Appears(*relay));
  TlsWebClient stranger(relay->port(), files.File("ca.crt"));
  ASSERT_TRUE(stranger.connected());
  EXPECT_EQ(stranger.Upgrade(), 401);
  TlsWebClient client(relay->port(), files.File("ca.crt"));
  ASSERT_EQ(client.Upgrade("Authorization: Api-Key mine\r\n"), 101);
  EXPECT_EQ(client.Read().payload, "greeting");
  client.SendFrame("over tls");
  EXPECT_EQ(client.Read().payload, "over tls");
  EXPECT_EQ(key, "Api-Key theirs") << "the client's was for this port";
  WebClient plain(relay->port(), 3);
  EXPECT_EQ(plain.Upgrade(), 0);
  // Before a wss server: this relay before another.
  RelayOptions chained = To(absl::StrCat("wss://127.0.0.1:", relay->port()));
  chained.secrets.authority = files.Read("ca.crt");
  chained.secrets.token = "mine";
  const auto before = Start(chained);
  ASSERT_TRUE(Appears(*before));
  WebClient far(before->port());
  ASSERT_EQ(far.Upgrade(), 101);
  EXPECT_EQ(far.Read().payload, "greeting");
  far.SendFrame("and back");
  EXPECT_EQ(far.Read().payload, "and back");
}

// What stands between.
struct Probe : RelayTap {
  struct Log {
    std::vector<std::string> up, down, threw;
    int made = 0, ended = 0;
  };
  explicit Probe(Log& log) : log(log) { ++log.made; }
  ~Probe() override { ++log.ended; }
  void FromClient(std::string_view message, bool) override {
    log.up.emplace_back(message);
    if (message == "throw") throw std::runtime_error("as told");
  }
  std::optional<std::string> FromServer(std::string_view message, bool) override {
    log.down.emplace_back(message);
    if (message == "change") return "changed";
    if (message == "throw") throw std::runtime_error("again");
    return std::nullopt;
  }
  void Threw(const std::string& words) override { log.threw.push_back(words); }
  Log& log;
};

TEST(Relay, ATapChangesAnswersAndItsFailureChangesNothing) {
  Probe::Log log;
  const Upstream upstream(Echo);
  {
    const auto relay = Start(To(upstream.url()), [&log](const std::string& peer) {
      EXPECT_THAT(peer, HasSubstr("127.0.0.1:"));
      return std::make_unique<Probe>(log);
    });
    ASSERT_TRUE(Appears(*relay));
    for (int i = 0; i < 2; ++i) {
      WebClient client(relay->port());
      ASSERT_EQ(client.Upgrade(), 101);
      EXPECT_EQ(client.Read().payload, "greeting");
      for (const char* message : {"as it is", "change", "throw", "as it is"}) {
        client.SendFrame(message);
        EXPECT_EQ(client.Read().payload,
                  std::string(message) == "change" ? "changed" : std::string(message));
      }
    }
  }
  EXPECT_EQ(log.made, 2) << "one for each client";
  EXPECT_EQ(log.ended, 2);
  EXPECT_EQ(log.up.size(), 8u);
  EXPECT_EQ(log.down.size(), 10u);
  EXPECT_EQ(log.threw, (std::vector<std::string>{"as told", "again", "as told", "again"}));
}

TEST(Relay, SaysGoingAwayWhenItStops) {
  const Upstream upstream(Echo);
  auto relay = Start(To(upstream.url()));
  ASSERT_TRUE(Appears(*relay));
  WebClient client(relay->port());
  ASSERT_EQ(client.Upgrade(), 101);
  EXPECT_EQ(client.Read().payload, "greeting");
  std::thread stop([&relay] { relay.reset(); });
  EXPECT_EQ(client.Read().close_code(), 1001);
  stop.join();
}

TEST(Relay, NamesWhatIsWrongWithItsOptions) {
  RelayOptions options = To("http://somewhere");
  EXPECT_THAT(std::string(Relay::Start(options, nullptr).status().message()),
              HasSubstr("neither ws:// nor wss://"));
  options = To("ws://127.0.0.1:1");
  options.listen = "nowhere";
  EXPECT_THAT(std::string(Relay::Start(options, nullptr).status().message()),
              HasSubstr("must be HOST:PORT"));
  options.listen = "127.0.0.1:0";
  options.max_clients = 0;
  EXPECT_THAT(std::string(Relay::Start(options, nullptr).status().message()),
              HasSubstr("--max-clients is 0"));
}

}  // namespace
}  // namespace robostress
