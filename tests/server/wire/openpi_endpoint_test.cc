// openpi's protocol over a real socket, with a client made of the documented bytes.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <thread>

#include "adapter/method_options.h"
#include "adapter/methods.h"
#include "common/atomic_file.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/web_socket_client.h"
#include "server/wire/openpi/openpi_conversation.h"
#include "tests/common/wire/openpi_bytes.h"
#include "tests/server/sessions/fake_session_host.h"
#include "tests/server/wire/web_client.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;

constexpr absl::Duration kSoon = absl::Seconds(20);
constexpr char kSecret[] = "a-robots-secret";

std::string Pixels(int value, int width = 4, int height = 4) {
  return std::string(static_cast<size_t>(3 * width * height), static_cast<char>(value));
}

// What openpi's LIBERO client sends: two views, eight numbers in double, a prompt.
OpenpiBytes& LiberoKeys(OpenpiBytes& message, int image = 7) {
  message.Text("observation/image").Array("|u1", {4, 4, 3}, Pixels(image));
  message.Text("observation/wrist_image").Array("|u1", {4, 4, 3}, Pixels(image + 1));
  message.Text("observation/state").Numbers<double>("<f8", {8}, {0, 1, 2, 3, 4, 5, 6, 7});
  return message.Text("prompt").Text("put the bowl on the plate");
}
std::string LiberoObservation() {
  OpenpiBytes message;
  return LiberoKeys(message.Map(4)).bytes();
}

class OpenpiEndpointTest : public ::testing::Test {
 protected:
  void Start(const WebServerOptions& options = {}, const AccessTokens& tokens = {},
             const OpenpiInputOptions& input = {}) {
    tokens_ = tokens;
    OpenpiOptions openpi;
    openpi.input = input;
    openpi.session.suite = "openpi";
    openpi.session.scenario = "unknown";
    openpi.session.mode = ExecutionMode::kAsync;
    openpi.session.method = *MakeMethod("base");
    auto server = WebServer::Start(
        options,
        [](const WebRequest& request) -> WebReply {
          if (request.path == "/healthz") return {200, "text/plain", "OK\n"};
          return {426, "text/plain", "WebSocket\n"};
        },
        [this,
         openpi](const WebRequest& request) -> absl::StatusOr<std::unique_ptr<WebConversation>> {
          auto caller = tokens_.Authenticate(request.authorization);
          if (!caller.ok()) return caller.status();
          caller->host = request.peer.substr(0, request.peer.rfind(':'));
          return std::make_unique<OpenpiConversation>(openpi, &host_, &metrics_, *caller);
        },
        &metrics_);
    ASSERT_TRUE(server.ok()) << server.status();
    server_ = *std::move(server);
  }
  // A connected client that has read the greeting.
  std::unique_ptr<WebSocketClient> Connect(const std::string& token = "") {
    WebSocketOptions options;
    options.secrets.token = token;
    auto client =
        WebSocketClient::Connect(absl::StrCat("ws://127.0.0.1:", server_->port()), options);
    EXPECT_TRUE(client.ok()) << client.status();
    if (!client.ok()) return nullptr;
    EXPECT_FALSE((*client)->Receive(kSoon)->text);
    return *std::move(client);
  }
  // What comes back for a message; text: an error.
  static WebSocketMessage Ask(WebSocketClient& client, const std::string& message) {
    EXPECT_TRUE(client.Send(message).ok());
    auto answer = client.Receive(kSoon);
    EXPECT_TRUE(answer.ok()) << answer.status();
    return answer.ok() ? *std::move(answer) : WebSocketMessage();
  }
  // The same of bytes alone, for what a client that is in order cannot do.
  std::unique_ptr<WebClient> ConnectRaw() {
    auto client = std::make_unique<WebClient>(server_->port());
    EXPECT_EQ(client->Upgrade(), 101);
    EXPECT_EQ(client->Read().opcode, WebClient::kBinary);
    return client;
  }
  void AwaitConnections(int count) {
    for (int i = 0; i < 2000 && server_->connections() != count; ++i)
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    EXPECT_EQ(server_->connections(), count);
  }

  Metrics metrics_;
  FakeSessionHost host_;
  AccessTokens tokens_;
  std::unique_ptr<WebServer> server_;
};

TEST_F(OpenpiEndpointTest, ServesAnExistingClientUnchanged) {
  Start();
  WebClient client(server_->port());
  ASSERT_EQ(client.Upgrade(), 101);
  // RFC 6455's example key has one right answer.
  EXPECT_THAT(client.head(), HasSubstr("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="));
  EXPECT_EQ(client.head().find("permessage-deflate"), std::string::npos);
  const WebClient::Frame metadata = client.Read();
  EXPECT_EQ(metadata.opcode, WebClient::kBinary);
  ASSERT_TRUE(DecodeOpenpi(metadata.payload).ok());

  for (int i = 1; i <= 3; ++i) {
    client.SendFrame(LiberoObservation());
    const WebClient::Frame reply = client.Read();
    ASSERT_EQ(reply.opcode, WebClient::kBinary) << reply.payload;
    // The array as openpi's client decodes it: bin keys, float32, [horizon, action_dim].
    OpenpiBytes actions;
    std::vector<float> values;
    for (int row = 0; row < 10; ++row)
      values.insert(values.end(), 7, static_cast<float>(i) + 0.01f * static_cast<float>(row));
    actions.Text("actions").Numbers<float>("<f4", {10, 7}, values);
    EXPECT_THAT(reply.payload, HasSubstr(actions.bytes()));
    const auto decoded = DecodeOpenpi(reply.payload);
    ASSERT_TRUE(decoded.ok());
    EXPECT_GE(*OpenpiNumbers("t", *decoded->Find("policy_timing")->Find("infer_ms"), 1)->begin(),
              0);
    EXPECT_EQ(decoded->Find("server_timing")->Find("prev_total_ms") != nullptr, i > 1);
    EXPECT_EQ(std::get<int64_t>(decoded->Find("adapter")->Find("version")->value), 3);
  }
  ASSERT_EQ(host_.observations.size(), 3u);
  const Observation& seen = host_.observations[0];
  EXPECT_EQ(seen.instruction, "put the bowl on the plate");
  ASSERT_EQ(seen.views.size(), 2u);
  EXPECT_EQ(seen.views[0].camera, "agentview");
  EXPECT_EQ(seen.views[0].image.data[0], 7);
  EXPECT_EQ(seen.views[1].image.data[0], 8);
  EXPECT_EQ(seen.proprioception[7], 7);
  EXPECT_EQ(host_.chunks, (std::vector<int>{0, 1, 2}));
  client.Close();
  AwaitConnections(0);
  EXPECT_TRUE(host_.sessions.empty());  // nobody can come back to it
}

TEST_F(OpenpiEndpointTest, AnswersHealthBeforeAnyUpgrade) {
  Start();
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz"), std::pair(200, std::string("OK\n")));
  EXPECT_EQ(WebClient(server_->port()).Get("/other").first, 426);
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz", "", "HEAD"), std::pair(200, std::string()));
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz", "", "POST").first, 405);
}

TEST_F(OpenpiEndpointTest, TakesChannelsFirstFloatsAndTheOtherDialects) {
  Start();
  const auto client = Connect();
  std::string planes;
  for (int c = 1; c <= 3; ++c) planes += std::string(16, static_cast<char>(c));
  OpenpiBytes aloha;
  aloha.Map(3).Text("images").Map(3);
  aloha.Text("cam_high").Array("|u1", {3, 4, 4}, planes);
  aloha.Text("cam_left_wrist").Numbers<float>("<f4", {4, 4, 3}, std::vector<float>(48, 0.5f));
  aloha.Text("cam_right_wrist").Array("|u1", {3, 4, 4}, planes);
  aloha.Text("state").Numbers<float>("<f4", {8}, std::vector<float>(8, 1));
  aloha.Text("prompt").Bin("as bytes");
  ASSERT_FALSE(Ask(*client, aloha.bytes()).text);
  const std::vector<uint8_t>& data = host_.observations[0].views[0].image.data;
  EXPECT_EQ(data[0], 1);
  EXPECT_EQ(data[1], 2);
  EXPECT_EQ(data[47], 3);
  EXPECT_EQ(host_.observations[0].views[1].image.data[0], 127);
  EXPECT_EQ(host_.observations[0].instruction, "as bytes");

  OpenpiBytes droid;
  droid.Map(5);
  droid.Text("observation/exterior_image_1_left").Array("|u1", {4, 4, 3}, Pixels(1));
  droid.Text("observation/wrist_image_left").Array("|u1", {4, 4, 3}, Pixels(2));
  droid.Text("observation/joint_position").Numbers<double>("<f8", {7}, {0, 1, 2, 3, 4, 5, 6});
  droid.Text("observation/gripper_position").Numbers<double>("<f8", {1}, {9});
  droid.Text("prompt").Text("p");
  ASSERT_FALSE(Ask(*client, droid.bytes()).text);
  EXPECT_EQ(host_.observations[1].proprioception[7], 9);
}

TEST_F(OpenpiEndpointTest, SaysWhatIsWrongInATextFrameAndClosesWith1011) {
  Start();
  struct Case {
    std::string message, expected;
  };
  OpenpiBytes nan, small, no_prompt, state;
  nan.Map(4)
      .Text("observation/state")
      .Numbers<double>("<f8", {8}, std::vector<double>(8, std::nan("")));
  nan.Text("observation/image").Array("|u1", {4, 4, 3}, Pixels(1));
  nan.Text("observation/wrist_image").Array("|u1", {4, 4, 3}, Pixels(1)).Text("prompt").Text("p");
  small.Map(3).Text("observation/image").Array("|u1", {4, 4}, std::string(16, 'a'));
  small.Text("observation/wrist_image").Array("|u1", {4, 4, 3}, Pixels(1)).Text("prompt").Text("p");
  no_prompt.Map(1).Text("observation/state").Integer(1);
  state.Map(4).Text("observation/state").Numbers<double>("<f8", {3}, {1, 2, 3});
  state.Text("observation/image").Array("|u1", {4, 4, 3}, Pixels(1));
  state.Text("observation/wrist_image").Array("|u1", {4, 4, 3}, Pixels(1)).Text("prompt").Text("p");
  for (const Case& c : {Case{"\xc1", "no msgpack"},
                        {OpenpiBytes().Text("x").bytes(), "is no map"},
                        {nan.bytes(), "observation/state[0] is nan"},
                        {small.bytes(), "observation/image: has shape [4, 4]"},
                        {no_prompt.bytes(), "prompt: is missing"},
                        {state.bytes(), "holds 3 numbers, policy fake wants 8"},
                        {OpenpiBytes().Map(1).Text("prompt").Text("p").bytes(), "no views"}}) {
    const auto client = Connect();
    const WebSocketMessage text = Ask(*client, c.message);
    EXPECT_TRUE(text.text) << c.expected;
    EXPECT_THAT(text.bytes, HasSubstr(c.expected));
    EXPECT_THAT(std::string(client->Receive(kSoon).status().message()),
                HasSubstr("1011: Internal server error. Traceback included in previous frame."));
    EXPECT_EQ(client->close_code(), 1011);
  }
  EXPECT_TRUE(host_.observations.empty());
  const auto text = ConnectRaw();
  text->SendFrame("{}", WebClient::kText);
  EXPECT_THAT(text->Read().payload, HasSubstr("binary frames"));
}

TEST_F(OpenpiEndpointTest, LearnsFromAClientThatReportsWhatItExecuted) {
  Start();
  auto client = Connect();
  OpenpiBytes first;
  LiberoKeys(first.Map(6))
      .Text("session")
      .Map(3)
      .Text("method")
      .Text("ours")
      .Text("seed")
      .Integer(5);
  first.Text("suite").Text("tabletop_goal");
  first.Text("episode").Map(2).Text("task").Integer(2).Text("episode").Integer(1);
  std::string payload = Ask(*client, first.bytes()).bytes;
  auto reply = DecodeOpenpi(payload);
  ASSERT_TRUE(reply.ok()) << reply.status();
  const std::string token(
      std::get<std::string_view>(reply->Find("adapter")->Find("resume_token")->value));
  EXPECT_EQ(token, "secret");
  const SessionSpec& spec = host_.sessions.begin()->second;
  EXPECT_EQ(spec.method->method, "ours");
  EXPECT_EQ(spec.seed, 5);
  EXPECT_EQ(spec.suite, "tabletop_goal");
  EXPECT_EQ(spec.scenario, "unknown");
  EXPECT_EQ(host_.episodes.back().task, 2);

  const auto report = [](OpenpiBytes& message, uint64_t sequence) -> OpenpiBytes& {
    message.Text("executed").Map(5).Text("sequence").Integer(sequence);
    message.Text("prediction_id").Integer(1).Text("first_step").Integer(2);
    message.Text("q").Numbers<double>("<f8", {3, 7}, std::vector<double>(21, 0.25));
    return message.Text("p_base_tool").Numbers<double>("<f8", {3, 3}, std::vector<double>(9, 0.5));
  };
  OpenpiBytes second;
  second.Map(1);
  // A report alone: no observation, no actions.
  payload = Ask(*client, report(second, 1).bytes()).bytes;
  reply = DecodeOpenpi(payload);
  ASSERT_TRUE(reply.ok());
  EXPECT_EQ(reply->Find("actions"), nullptr);
  EXPECT_EQ(std::get<int64_t>(reply->Find("feedback")->Find("sequence")->value), 1);
  ASSERT_EQ(host_.taken.size(), 1u);
  const ExecutedChunk& chunk = host_.taken[0];
  EXPECT_EQ(chunk.task, 2);
  EXPECT_EQ(chunk.episode, 1);
  EXPECT_EQ(chunk.prediction_id, 1u);
  ASSERT_EQ(chunk.steps.size(), 2u);
  EXPECT_FLOAT_EQ(chunk.steps[0].policy_command[0], 1.02f);  // row 2 of the reply
  EXPECT_EQ(chunk.steps[0].sent_command, chunk.steps[0].policy_command);
  EXPECT_EQ(chunk.final_state.q[0], 0.25);
  EXPECT_EQ(chunk.final_state.tool.p_base_tool[0], 0.5);
  EXPECT_NEAR(chunk.final_state.stamp_s, 0.1, 1e-12);

  // The reply to the report was lost: the client comes back and repeats it.
  client.reset();
  AwaitConnections(0);
  EXPECT_EQ(host_.sessions.size(), 1u);
  const auto again = Connect();
  OpenpiBytes resume;
  LiberoKeys(resume.Map(5)).Text("session").Map(1).Text("resume").Map(2);
  resume.Text("id").Text("session-1").Text("token").Text(token);
  ASSERT_FALSE(Ask(*again, resume.bytes()).text);
  // Where it was: no episode is begun, which would clear a buffer, and the next chunk follows.
  EXPECT_EQ(host_.episodes.size(), 1u);
  EXPECT_EQ(host_.predictions.back().key.episode.task, 2);
  EXPECT_EQ(host_.chunks.back(), 1);
  OpenpiBytes repeated;
  repeated.Map(1).Text("executed").Map(3).Text("sequence").Integer(1);
  repeated.Text("prediction_id").Integer(77);  // whatever it says that it was about
  repeated.Text("q").Numbers<double>("<f8", {3, 7}, std::vector<double>(21, 0.25));
  payload = Ask(*again, repeated.bytes()).bytes;
  reply = DecodeOpenpi(payload);
  ASSERT_TRUE(reply.ok());
  EXPECT_TRUE(std::get<bool>(reply->Find("feedback")->Find("duplicate")->value));
  EXPECT_EQ(host_.taken.size(), 1u);
  // The rest of the chunk that the first connection was given.
  OpenpiBytes rest;
  rest.Map(1);
  payload = Ask(*again, report(rest, 2).bytes()).bytes;
  reply = DecodeOpenpi(payload);
  ASSERT_TRUE(reply.ok()) << payload;
  EXPECT_FALSE(std::get<bool>(reply->Find("feedback")->Find("duplicate")->value));
  ASSERT_EQ(host_.taken.size(), 2u);
  EXPECT_EQ(host_.taken[1].chunk, 0);
  EXPECT_FLOAT_EQ(host_.taken[1].steps[0].sent_command[0], 1.02f);
  // A message that reports, begins an episode and predicts finds its session once.
  const int uses = host_.uses;
  OpenpiBytes all;
  all.Map(6);
  report(LiberoKeys(all), 3).Text("episode").Map(2);
  all.Text("task").Integer(4).Text("episode").Integer(0);
  payload = Ask(*again, all.bytes()).bytes;
  ASSERT_TRUE(DecodeOpenpi(payload).ok()) << payload;
  EXPECT_EQ(host_.taken.size(), 3u);
  EXPECT_EQ(host_.chunks.back(), 0);
  EXPECT_EQ(host_.uses, uses + 1);

  const auto thief = Connect();
  OpenpiBytes wrong;
  LiberoKeys(wrong.Map(5)).Text("session").Map(1).Text("resume").Map(2);
  wrong.Text("id").Text("session-1").Text("token").Text("guess");
  EXPECT_THAT(Ask(*thief, wrong.bytes()).bytes, HasSubstr("not its token"));
}

TEST_F(OpenpiEndpointTest, StartsTheNextEpisodeOnReset) {
  Start();
  const auto client = Connect();
  for (int i = 0; i < 2; ++i) {
    OpenpiBytes message;
    LiberoKeys(message.Map(5)).Text("reset").True();
    ASSERT_FALSE(Ask(*client, message.bytes()).text);
  }
  ASSERT_EQ(host_.episodes.size(), 2u);
  EXPECT_EQ(host_.episodes[1].episode, 1);
  EXPECT_EQ(host_.chunks, (std::vector<int>{0, 0}));
  // With both, the one that is named begins anew, though it plays already.
  for (int i = 0; i < 2; ++i) {
    OpenpiBytes message;
    LiberoKeys(message.Map(6)).Text("reset").True();
    message.Text("episode").Map(2).Text("task").Integer(0).Text("episode").Integer(7);
    ASSERT_FALSE(Ask(*client, message.bytes()).text);
  }
  ASSERT_EQ(host_.episodes.size(), 4u);
  EXPECT_EQ(host_.episodes[3].episode, 7);
  EXPECT_EQ(host_.chunks, (std::vector<int>{0, 0, 0, 0}));
}

TEST_F(OpenpiEndpointTest, AsksForATokenAndItsScopes) {
  const auto tokens = AccessTokens::Parse(
      "t",
      absl::StrCat("tokens: [{name: arm, sha256: ", Sha256Hex(kSecret), ", scopes: [predict]}]"));
  ASSERT_TRUE(tokens.ok());
  Start({}, *tokens);
  EXPECT_EQ(WebClient(server_->port()).Upgrade(), 401);
  EXPECT_EQ(WebClient(server_->port()).Upgrade("Authorization: Api-Key wrong\r\n"), 401);
  const auto client = Connect(kSecret);
  EXPECT_FALSE(Ask(*client, LiberoObservation()).text);
  OpenpiBytes message;
  message.Map(1).Text("executed").Map(1).Text("q");
  message.Numbers<double>("<f8", {3, 7}, std::vector<double>(21, 0.25));
  EXPECT_THAT(Ask(*client, message.bytes()).bytes, HasSubstr("'arm' has no scope 'feedback'"));
  EXPECT_TRUE(host_.taken.empty());
}

TEST_F(OpenpiEndpointTest, GivesAPageOfAnotherOriginNoWebSocket) {
  Start();
  EXPECT_EQ(WebClient(server_->port()).Upgrade("Origin: https://elsewhere.example\r\n"), 403);
  EXPECT_EQ(WebClient(server_->port()).Upgrade("Origin: http://127.0.0.1\r\n"), 101);
}

TEST_F(OpenpiEndpointTest, AnswersNoBrowserThatNamesAForeignHost) {
  WebServerOptions options;
  options.allowed_hosts = {"robot.example"};
  Start(options);
  const auto get = [this](const std::string& path, const std::string& host) {
    return WebClient(server_->port()).Get(path, "", "GET", host);
  };
  const auto [status, message] = get("/", "attacker.example:8000");
  EXPECT_EQ(status, 421);
  EXPECT_THAT(message, AllOf(HasSubstr("'attacker.example:8000'"), HasSubstr("--allowed-hosts")));
  EXPECT_EQ(get("/", "").first, 421);
  EXPECT_EQ(get("/", "127.0.0.1.attacker.example").first, 421);
  for (const char* known : {"127.0.0.1", "127.0.0.1:8000", "[::1]:8000", "LOCALHOST:1",
                            "Robot.example:8000", "192.0.2.7"})
    EXPECT_EQ(get("/", known).first, 426) << known;
  EXPECT_EQ(get("/healthz", "attacker.example").first, 200);
  const auto upgrade = [this](const std::string& origin, const std::string& host) {
    return WebClient(server_->port()).Upgrade(origin, host);
  };
  // The page's origin and the host agree: only the name gives it away.
  EXPECT_EQ(upgrade("Origin: http://attacker.example\r\n", "attacker.example"), 421);
  EXPECT_EQ(upgrade("Origin: http://robot.example\r\n", "robot.example"), 101);
  EXPECT_EQ(upgrade("", "attacker.example"), 101);  // no browser
}

TEST_F(OpenpiEndpointTest, ClosesOnAMessageBeyondTheLimitBeforeItIsThere) {
  WebServerOptions options;
  options.max_message_bytes = 100000;
  Start(options);
  const auto client = ConnectRaw();
  std::string frame = WebClient::FrameBytes(std::string(200000, 'x'));
  client->Send(frame.substr(0, 200));  // the header says enough
  const WebClient::Frame close = client->Read();
  EXPECT_EQ(close.opcode, WebClient::kClose);
  EXPECT_EQ(close.close_code(), 1009);
}

TEST_F(OpenpiEndpointTest, TakesMessagesAsLargeAsItsPolicyNeeds) {
  host_.spec.image_width = host_.spec.image_height = 64;
  Start();
  // Its own size in float64 is taken, which is 8 times what a client sends.
  const auto floats = [](int side) {
    OpenpiBytes message;
    message.Map(4);
    for (const char* key : {"observation/image", "observation/wrist_image"})
      message.Text(key).Numbers<double>("<f8", {side, side, 3},
                                        std::vector<double>(static_cast<size_t>(3 * side * side)));
    message.Text("observation/state").Numbers<double>("<f8", {8}, std::vector<double>(8));
    return message.Text("prompt").Text("p").bytes();
  };
  const auto client = ConnectRaw();
  client->SendFrame(floats(64));
  EXPECT_EQ(client->Read().opcode, WebClient::kBinary);
  // From now on it is the session's own policy that says what is too large.
  client->Send(WebClient::FrameBytes(std::string(400000, 'x')).substr(0, 200));
  EXPECT_EQ(client->Read().close_code(), 1009);
  // Before, a client may still ask for resizing; megabytes have no place in either.
  const auto early = ConnectRaw();
  early->SendFrame(std::string(400000, 'x'));
  EXPECT_EQ(early->Read().opcode, WebClient::kText);
  const auto large = ConnectRaw();
  large->Send(WebClient::FrameBytes(std::string(8 << 20, 'x')).substr(0, 200));
  EXPECT_EQ(large->Read().close_code(), 1009);
}

TEST_F(OpenpiEndpointTest, ResizesViewsForWhomItWasAskedFor) {
  host_.spec.model_hash = "5a5a";
  host_.spec.image_width = host_.spec.image_height = 64;
  const auto observation = [](const std::string& session, int width = 224, int height = 168) {
    OpenpiBytes message;
    message.Map(session.empty() ? 4 : 5);
    if (!session.empty()) message.Text("session").Map(1).Text(session).True();
    for (const char* key : {"observation/image", "observation/wrist_image"})
      message.Text(key).Array("|u1", {height, width, 3}, Pixels(9, width, height));
    message.Text("observation/state").Numbers<double>("<f8", {8}, std::vector<double>(8));
    return message.Text("prompt").Text("p").bytes();
  };
  Start();
  const auto stock = Connect();
  EXPECT_THAT(Ask(*stock, observation("")).bytes,
              AllOf(HasSubstr("observation/image: is 224 x 168, policy fake takes 64 x 64"),
                    HasSubstr("session: {resize: true}"), HasSubstr("--websocket-resize")));
  const auto asking = Connect();
  EXPECT_FALSE(Ask(*asking, observation("resize")).text);
  EXPECT_FALSE(Ask(*asking, observation("")).text);
  const auto wide = Connect();
  EXPECT_THAT(Ask(*wide, observation("resize", 300, 2)).bytes,
              AllOf(HasSubstr("observation/image: is 300 x 2, a side must be 1..256"),
                    HasSubstr("--max-view-side")));
  // With padding, as openpi's clients do it: the picture in the middle, black above and below.
  ASSERT_EQ(host_.observations.size(), 2u);
  for (const Observation& seen : host_.observations) {
    const Image& image = seen.views[1].image;
    ASSERT_EQ(image.data.size(), 3u * 64 * 64);
    EXPECT_EQ(image.data[3 * (7 * 64 + 30)], 0);
    EXPECT_EQ(image.data[3 * (8 * 64 + 30)], 9);
    EXPECT_EQ(image.data[3 * (55 * 64 + 30)], 9);
    EXPECT_EQ(image.data[3 * (56 * 64 + 30)], 0);
  }

  OpenpiInputOptions input;
  input.resize = true;
  Start({}, {}, input);
  WebClient client(server_->port());
  ASSERT_EQ(client.Upgrade(), 101);
  const std::string greeting = client.Read().payload;
  const auto metadata = DecodeOpenpi(greeting);
  ASSERT_TRUE(metadata.ok());
  const OpenpiValue& policy =
      std::get<OpenpiValue::List>(metadata->Find("policies")->value).front();
  EXPECT_EQ(std::get<std::string_view>(policy.Find("model_hash")->value), "5a5a");
  EXPECT_EQ(std::get<int64_t>(policy.Find("image_width")->value), 64);
  EXPECT_EQ(std::get<int64_t>(policy.Find("image_height")->value), 64);
  EXPECT_EQ(std::get<int64_t>(policy.Find("max_view_side")->value), 1280);
  EXPECT_TRUE(std::get<bool>(policy.Find("resizes_images")->value));
  client.SendFrame(observation("", 1280, 720));
  EXPECT_EQ(client.Read().opcode, WebClient::kBinary);
}

TEST_F(OpenpiEndpointTest, NamesTheKeyThatTheClientUsed) {
  Start();
  const auto refusal = [this](const std::string& message) {
    const auto client = Connect();
    return Ask(*client, message).bytes;
  };
  const auto with_state = [](const std::string& key, const std::vector<double>& values) {
    OpenpiBytes message;
    message.Map(4).Text("observation/image").Array("|u1", {4, 4, 3}, Pixels(1));
    message.Text("observation/wrist_image").Array("|u1", {4, 4, 3}, Pixels(1));
    message.Text("prompt").Text("p");
    const int size = static_cast<int>(values.size());
    if (key.empty()) {
      message.Text("observation").Map(2).Text("joint_position");
      message.Numbers<double>("<f8", {size - 1}, {values.begin(), values.end() - 1});
      return message.Text("gripper_position").Numbers<double>("<f8", {1}, {values.back()}).bytes();
    }
    return message.Text(key).Numbers<double>("<f8", {size}, values).bytes();
  };
  std::vector<double> values(8, 1.0);
  values[7] = 1e300;
  EXPECT_THAT(refusal(with_state("state", values)), HasSubstr("state[7] is 1e+300"));
  EXPECT_THAT(refusal(with_state("", values)),
              HasSubstr("observation/gripper_position[0] is 1e+300, too large for a float32"));
  values[7] = 1;
  values[2] = std::nan("");
  EXPECT_THAT(refusal(with_state("", values)), HasSubstr("observation/joint_position[2] is nan"));
  EXPECT_THAT(
      refusal(with_state("", {1, 2})),
      HasSubstr("observation/joint_position + observation/gripper_position: holds 2 numbers"));
  EXPECT_THAT(refusal(with_state("robot_state", {1, 2})),
              AllOf(HasSubstr("no state among the keys"), HasSubstr("robot_state"),
                    HasSubstr("observation/joint_position")));
  const auto with_session = [](const std::string& key, const std::string& value) {
    OpenpiBytes message;
    LiberoKeys(message.Map(5)).Text("session").Map(1);
    return message.Text(key).Text(value).bytes();
  };
  EXPECT_THAT(refusal(with_session("suite", "two words")),
              HasSubstr("session/suite contains byte"));
  EXPECT_THAT(refusal(with_session("method", "magic")),
              AllOf(HasSubstr("session/method"), HasSubstr("unknown method 'magic'; known: base")));
  EXPECT_THAT(refusal(with_session("method", "")), HasSubstr("unknown method ''; known: base"));
  OpenpiBytes options;
  LiberoKeys(options.Map(5)).Text("session").Map(1).Text("method_options");
  options.Byte(0x91).Text("learning_rate=0.1");
  EXPECT_THAT(refusal(options.bytes()),
              AllOf(HasSubstr("session/method_options"), HasSubstr("name one of: base, ours")));
  options = {};
  LiberoKeys(options.Map(5)).Text("session").Map(2).Text("method").Text("ours");
  options.Text("method_options").Byte(0x91).Text("method=base");
  EXPECT_THAT(refusal(options.bytes()), HasSubstr("names another preset"));
}

TEST_F(OpenpiEndpointTest, EndsTheClientAndNotTheServerWhenMemoryRunsOut) {
  Start();
  host_.out_of_memory = true;
  const auto client = Connect();
  const WebSocketMessage text = Ask(*client, LiberoObservation());
  EXPECT_TRUE(text.text);
  EXPECT_THAT(text.bytes, HasSubstr("the message was not answered: std::bad_alloc"));
  EXPECT_FALSE(client->Receive(kSoon).ok());
  EXPECT_EQ(client->close_code(), 1011);
  host_.out_of_memory = false;
  const auto next = Connect();
  EXPECT_FALSE(Ask(*next, LiberoObservation()).text);
}

TEST_F(OpenpiEndpointTest, EndsABrokenFrameWithItsCode) {
  Start();
  const std::string masked = WebClient::FrameBytes("hello");
  std::string reserved_bit = masked, reserved_opcode = masked,
              unmasked(
                  "\x82\x03"
                  "abc"),
              fragmented_ping = WebClient::FrameBytes("x", WebClient::kPing), continuation = masked;
  reserved_bit[0] = static_cast<char>(0xc2);
  reserved_opcode[0] = static_cast<char>(0x83);
  fragmented_ping[0] = 0x09;
  continuation[0] = static_cast<char>(0x80);
  for (const std::string& frame :
       {reserved_bit, reserved_opcode, unmasked, fragmented_ping, continuation}) {
    const auto client = ConnectRaw();
    client->Send(frame);
    const WebClient::Frame close = client->Read();
    EXPECT_EQ(close.opcode, WebClient::kClose);
    EXPECT_EQ(close.close_code(), 1002);
  }
  const auto text = ConnectRaw();
  text->SendFrame("\xff", WebClient::kText);
  EXPECT_EQ(text->Read().close_code(), 1007);
}

TEST_F(OpenpiEndpointTest, SurvivesAStreamCutAtEveryByteOfAMessage) {
  Start();
  const std::string frame = WebClient::FrameBytes(LiberoObservation());
  const size_t step = 7;  // every part of the frame's and the message's headers
  for (size_t size = 0; size < frame.size(); size += size < 64 ? 1 : step) {
    const auto client = ConnectRaw();
    client->Send(frame.substr(0, size));
    client->Close();
  }
  AwaitConnections(0);
  EXPECT_TRUE(host_.observations.empty());
  EXPECT_TRUE(host_.sessions.empty());
  const auto client = ConnectRaw();
  client->SendFrame(LiberoObservation());
  EXPECT_EQ(client->Read().opcode, WebClient::kBinary);
}

TEST_F(OpenpiEndpointTest, SurvivesAnythingInPlaceOfHttp) {
  WebServerOptions options;
  options.request_timeout = absl::Milliseconds(300);
  Start(options);
  for (const std::string& bytes :
       {std::string("\x16\x03\x01 hello"), std::string("GET\r\n\r\n"), std::string(20000, 'A'),
        std::string("GET / HTTP/1.1\r\nX: ") + std::string(20000, 'A'), std::string("GET / HT")}) {
    WebClient client(server_->port());
    client.Send(bytes);
    client.Receive(SIZE_MAX);  // answered or cut: it ends
  }
  AwaitConnections(0);
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz").first, 200);
}

TEST_F(OpenpiEndpointTest, CutsAConnectionThatNoLongerAnswers) {
  WebServerOptions options;
  options.idle_timeout = absl::Milliseconds(400);
  Start(options);
  const auto half_open = ConnectRaw();  // never answers the pings
  AwaitConnections(1);
  AwaitConnections(0);
}

TEST_F(OpenpiEndpointTest, KeepsAConnectionThatIsSilentButAnswersPings) {
  WebServerOptions options;
  options.idle_timeout = absl::Seconds(1);
  Start(options);
  const auto client = Connect();
  std::this_thread::sleep_for(std::chrono::milliseconds(2500));
  EXPECT_EQ(server_->connections(), 1);
  EXPECT_FALSE(Ask(*client, LiberoObservation()).text);
}

TEST_F(OpenpiEndpointTest, CutsAReaderThatDoesNotRead) {
  host_.spec.horizon = 1000;
  host_.spec.action_dim = 250;  // 1 MB a reply: more than the sockets hold after a few
  WebServerOptions options;
  options.idle_timeout = absl::Milliseconds(600);
  Start(options);
  const auto client = ConnectRaw();
  for (int i = 0; i < 40; ++i) client->SendFrame(LiberoObservation());
  AwaitConnections(0);
  EXPECT_LT(host_.observations.size(), 40u);  // one reply at a time: it waited for the reader
}

TEST_F(OpenpiEndpointTest, RefusesConnectionsBeyondTheLimitButAnswersProbes) {
  WebServerOptions options;
  options.max_connections = options.max_connections_per_client = 2;
  Start(options);
  const auto first = ConnectRaw(), second = ConnectRaw();
  WebClient third(server_->port());
  EXPECT_EQ(third.Upgrade(), 503);
  EXPECT_EQ(WebClient(server_->port()).Get("/").first, 503);
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz"), std::pair(200, std::string("OK\n")));
  // Whoever sits in the probes' places without a word leaves them soon.
  std::vector<std::unique_ptr<WebClient>> silent;
  AwaitConnections(2);
  for (int i = 0; i < WebServerOptions::kHealthPlaces; ++i)
    silent.push_back(std::make_unique<WebClient>(server_->port()));
  AwaitConnections(2 + WebServerOptions::kHealthPlaces);
  EXPECT_THAT(WebClient(server_->port()).Receive(SIZE_MAX), HasSubstr("503"));
  AwaitConnections(2);
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz").first, 200);
  first->Close();
  AwaitConnections(1);
  const auto fourth = ConnectRaw();
}

TEST_F(OpenpiEndpointTest, GivesOneClientNoMoreThanItsShareOfTheConnections) {
  WebServerOptions options;
  options.max_connections = 4;
  Start(options);
  const auto first = ConnectRaw(), second = ConnectRaw();  // half of them
  EXPECT_EQ(WebClient(server_->port()).Upgrade(), 503);
  const auto [status, message] = WebClient(server_->port()).Get("/");
  EXPECT_EQ(status, 503);
  EXPECT_THAT(message, HasSubstr("--connections-per-client"));
  EXPECT_EQ(WebClient(server_->port()).Get("/healthz").first, 200);
  AwaitConnections(2);
  first->Close();
  AwaitConnections(1);
  const auto third = ConnectRaw();
}

TEST_F(OpenpiEndpointTest, CountsConnectionsByWhoeverTheirTokenNames) {
  const auto tokens = AccessTokens::Parse(
      "t", absl::StrCat("tokens: [{name: arm, sha256: ", Sha256Hex(kSecret),
                        ", scopes: [predict]}, {name: other, sha256: ", Sha256Hex("another"),
                        ", scopes: [predict]}]"));
  ASSERT_TRUE(tokens.ok()) << tokens.status();
  WebServerOptions options;
  options.max_connections = 8;
  options.max_connections_per_client = 2;
  Start(options, *tokens);
  const auto first = Connect(kSecret), second = Connect(kSecret);
  WebSocketOptions third;
  third.secrets.token = kSecret;
  const auto refused =
      WebSocketClient::Connect(absl::StrCat("ws://127.0.0.1:", server_->port()), third);
  EXPECT_EQ(refused.status().code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(std::string(refused.status().message()),
              AllOf(HasSubstr("HTTP 503"), HasSubstr("holds 2 connections")));
  const auto other = Connect("another");  // from the same address
}

TEST_F(OpenpiEndpointTest, SaysGoodbyeWhenItIsStopped) {
  Start();
  const auto client = ConnectRaw();
  std::thread stopping([this] { server_->Stop(absl::Seconds(5)); });
  const WebClient::Frame close = client->Read();
  EXPECT_EQ(close.opcode, WebClient::kClose);
  EXPECT_EQ(close.close_code(), 1001);
  client->SendFrame(close.payload, WebClient::kClose);
  EXPECT_EQ(client->Read().opcode, -1);
  client->Close();
  stopping.join();
}

TEST_F(OpenpiEndpointTest, LosesNothingToAThousandConnections) {
  Start();
  for (int i = 0; i < 1000; ++i) {
    const auto client = ConnectRaw();
    if (i % 10 == 0) {
      client->SendFrame(LiberoObservation());
      ASSERT_EQ(client->Read().opcode, WebClient::kBinary);
    }
  }
  AwaitConnections(0);
  EXPECT_EQ(host_.opened, 100);
  EXPECT_TRUE(host_.sessions.empty());
}

TEST_F(OpenpiEndpointTest, ReadsTheRowsOfARunningChunk) {
  Start();
  const auto client = Connect();
  const auto ask = [&](int rows, int held) {
    OpenpiBytes message;
    LiberoKeys(message.Map(5)).Text("running").Map(2).Text("held").Integer(held);
    message.Text("actions").Numbers<float>(
        "<f4", {rows, host_.spec.action_dim},
        std::vector<float>(static_cast<size_t>(rows * host_.spec.action_dim), 0.25f));
    return Ask(*client, message.bytes());
  };
  ASSERT_FALSE(Ask(*client, LiberoObservation()).text);
  ASSERT_FALSE(ask(3, 2).text);
  ASSERT_EQ(host_.running.size(), 2u);
  EXPECT_FALSE(host_.running[0]);
  ASSERT_TRUE(host_.running[1]);
  EXPECT_EQ(host_.running[1]->held, 2);
  EXPECT_EQ(host_.running[1]->actions, Eigen::MatrixXf::Constant(3, host_.spec.action_dim, 0.25f));
  const WebSocketMessage refused = ask(1, 2);
  EXPECT_TRUE(refused.text);
  EXPECT_THAT(refused.bytes, HasSubstr("running/held"));
}

}  // namespace
}  // namespace robostress
