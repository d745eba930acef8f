#include "common/wire/vla_eval_conversation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <mutex>
#include <thread>

#include "common/wire/openpi_dialect.h"
#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_writer.h"
#include "common/wire/remote_policy.h"
#include "tests/common/wire/scripted_peer.h"

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

using Keys = OpenpiWriter::ArrayKeys;

// vla-eval's server as far as a test wants one. `answer` gets the number of the observation, from
// 0, and its seq.
class ModelPeer {
 public:
  using Script = std::function<std::string(int observation, int64_t seq)>;

  explicit ModelPeer(Script answer, std::string params = OpenpiWriter().Map(0).Take(),
                     int64_t protocol = 1)
      : thread_([this, answer = std::move(answer), params = std::move(params), protocol] {
          while (true) {
            ScriptedPeer::Error error;
            ScriptedPeer::Tcp::socket socket(io_);
            acceptor_.accept(socket, error);
            if (error || ended_) return;
            ScriptedPeer::Socket web(std::move(socket));
            web.accept(error);
            web.binary(true);
            if (!error) Serve(web, answer, params, protocol);
          }
        }) {}
  // Its clients are gone.
  ~ModelPeer() {
    ended_ = true;
    ScriptedPeer::Error ignored;
    ScriptedPeer::Tcp::socket(io_).connect(acceptor_.local_endpoint(), ignored);
    thread_.join();
  }

  static std::string Message(const char* type, const std::string& payload, int64_t seq) {
    OpenpiWriter message;
    message.Map(4).Text("type").Text(type).Text("payload").Value(payload);
    return message.Text("seq").Integer(seq).Text("timestamp").Real(1.5).Take();
  }
  static std::string Action(double value, int64_t seq, const char* key = "actions") {
    return Message("action",
                   OpenpiWriter(Keys::kText)
                       .Map(2)
                       .Text(key)
                       .Numbers(std::vector<double>(7, value))
                       .Text("more")
                       .Integer(1)
                       .Take(),
                   seq);
  }
  std::string url() const {
    return absl::StrCat("ws://127.0.0.1:", acceptor_.local_endpoint().port());
  }
  std::vector<std::string> types() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return types_;
  }
  // Of episode starts and observations; OpenpiValue views it.
  std::string told(size_t i) const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return told_.at(i);
  }

 private:
  void Serve(ScriptedPeer::Socket& web, const Script& answer, const std::string& params,
             int64_t protocol) {
    for (int observation = 0;;) {
      const std::string bytes = ScriptedPeer::Read(web);
      if (bytes.empty()) return;
      const OpenpiValue message = *DecodeOpenpi(std::string_view(bytes));
      const std::string type(std::get<std::string_view>(message.Find("type")->value));
      const int64_t seq = std::get<int64_t>(message.Find("seq")->value);
      {
        const std::lock_guard<std::mutex> lock(mutex_);
        types_.push_back(type);
        if (type == "episode_start" || type == "observation") told_.push_back(bytes);
      }
      if (type == "observation") ScriptedPeer::Write(web, answer(observation++, seq));
      if (type != "hello") continue;
      OpenpiWriter payload;
      payload.Map(3).Text("model_server").Text("Toy").Text("protocol_version");
      payload.Integer(protocol).Text("observation_params").Value(params);
      ScriptedPeer::Write(web, Message("hello", payload.Take(), seq));
    }
  }

  boost::asio::io_context io_;
  ScriptedPeer::Tcp::acceptor acceptor_{
      io_, ScriptedPeer::Tcp::endpoint(boost::asio::ip::make_address("127.0.0.1"), 0)};
  std::atomic<bool> ended_ = false;
  mutable std::mutex mutex_;
  std::vector<std::string> types_, told_;
  std::thread thread_;
};

class VlaEvalWire : public ::testing::Test {
 protected:
  VlaEvalWire() {
    setting_.policy = "toy";
    setting_.suite = "tabletop_goal";
    UseDialect(*OpenpiDialectNamed("vla_eval"), options_);
    for (const char* camera : {"agentview", "robot0_eye_in_hand"})
      observation_.views.push_back({camera, {2, 2, std::vector<uint8_t>(12, 7)}});
    observation_.instruction = "lift it";
    observation_.proprioception = Eigen::VectorXf::LinSpaced(8, 1, 8);
    connection_.wire.metadata_timeout = connection_.answer_timeout =
        connection_.first_answer_timeout = absl::Seconds(5);
    connection_.absence = absl::Milliseconds(300);
  }
  absl::StatusOr<std::unique_ptr<RemotePolicy>> Connect(const std::string& url) {
    auto policy = RemotePolicy::Connect(url, options_, setting_, "policy", connection_);
    if (!policy.ok()) return policy;
    EXPECT_TRUE((*policy)->StartEpisode({3, 4}).ok());
    observation_.views.resize((*policy)->spec().cameras.size());
    return policy;
  }
  static std::string Params(std::initializer_list<const char*> wishes) {
    OpenpiWriter params;
    params.Map(static_cast<uint32_t>(wishes.size()));
    for (const char* wish : wishes) params.Text(wish).Boolean(true);
    return params.Take();
  }
  absl::Status Failure(ModelPeer::Script answer) {
    const ModelPeer server(std::move(answer));
    auto policy = Connect(server.url());
    if (!policy.ok()) return policy.status();
    const absl::Status status = (*policy)->Predict(observation_, 0).status();
    EXPECT_THAT(std::string(status.message()), HasSubstr(server.url()));
    return status;
  }

  SessionSetting setting_;
  RemotePolicyOptions options_;
  RemotePolicyConnection connection_;
  Observation observation_;
};

TEST_F(VlaEvalWire, GreetsFirstAndTellsWhereEpisodesBeginAndEnd) {
  const ModelPeer server(
      [](int observation, int64_t seq) { return ModelPeer::Action(0.25 * observation, seq); });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  EXPECT_THAT((*policy)->metadata(), HasSubstr(R"("model_server":"Toy")"));
  EXPECT_EQ((*policy)->spec().execute_steps, 1);
  EXPECT_EQ((*policy)->spec().image_width, 256);
  for (int chunk : {0, 1}) {
    const auto predicted = (*policy)->Predict(observation_, chunk);
    ASSERT_TRUE(predicted.ok()) << predicted.status();
    EXPECT_EQ(predicted->actions, Eigen::MatrixXf::Constant(1, 7, 0.25f * chunk));
  }
  ExecutedChunk last;
  last.last_of_episode = true;
  ASSERT_TRUE((*policy)->SendFeedback(last).ok());
  ASSERT_TRUE((*policy)->StartEpisode({3, 5}).ok());
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  // An episode without an end, as where the unit was cut short.
  ASSERT_TRUE((*policy)->StartEpisode({3, 6}).ok());
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  EXPECT_THAT(
      server.types(),
      ElementsAre("hello", "hello", "episode_start", "observation", "observation", "episode_end",
                  "episode_start", "observation", "episode_end", "episode_start", "observation"));
  const std::string start = server.told(0);
  const OpenpiValue told = *DecodeOpenpi(std::string_view(start));
  const OpenpiValue* task = told.Find("payload")->Find("task");
  EXPECT_EQ(std::get<std::string_view>(task->Find("name")->value), "lift it");
  EXPECT_EQ(std::get<std::string_view>(task->Find("suite")->value), "tabletop_goal");
  EXPECT_EQ(std::get<int64_t>(task->Find("task_id")->value), 3);
  EXPECT_EQ(std::get<int64_t>(task->Find("episode_idx")->value), 4);
}

TEST_F(VlaEvalWire, ShowsWhatTheModelWishesForAndNoMore) {
  const auto asked = [&](const std::string& params) {
    const ModelPeer server([](int, int64_t seq) { return ModelPeer::Action(0, seq); }, params);
    auto policy = Connect(server.url());
    EXPECT_TRUE(policy.ok()) << policy.status();
    EXPECT_TRUE((*policy)->Predict(observation_, 0).ok());
    return server.told(1);
  };
  const std::string everything =
      asked(Params({"send_state", "send_wrist_image", "quat_no_antipodal"}));
  const OpenpiValue told = *DecodeOpenpi(std::string_view(everything));
  const OpenpiValue* payload = told.Find("payload");
  EXPECT_EQ(std::get<std::string_view>(payload->Find("task_description")->value), "lift it");
  EXPECT_THAT(*OpenpiNumbers("states", *payload->Find("states"), 8),
              ElementsAre(1, 2, 3, 4, 5, 6, 7, 8));
  EXPECT_THAT(everything, HasSubstr("\xab__ndarray__\xc3")) << "vla-eval takes text keys alone";
  for (const char* view : {"agentview", "wrist"}) {
    const OpenpiValue* image = payload->Find("images")->Find(view);
    ASSERT_NE(image, nullptr) << view;
    EXPECT_TRUE(std::get<bool>(image->Find("__image__")->value));
    EXPECT_EQ(std::get<std::string_view>(image->Find("format")->value), "png");
    EXPECT_THAT(std::string(std::get<std::string_view>(image->Find("data")->value)),
                ::testing::StartsWith("\x89PNG"));
    EXPECT_THAT(*OpenpiNumbers("shape", *image->Find("shape"), 3), ElementsAre(2, 2, 3));
  }

  // A rotation is turned the shorter way unless the server wants robosuite's: (4, 5, 6) is longer
  // than pi by far, and what is left of it after a turn has the same direction or the opposite.
  observation_.views.assign(2, observation_.views[0]);
  const std::string turned = asked(Params({"send_state"}));
  const OpenpiValue other = *DecodeOpenpi(std::string_view(turned));
  EXPECT_EQ(other.Find("payload")->Find("images")->Find("wrist"), nullptr);
  const std::vector<double> state =
      *OpenpiNumbers("states", *other.Find("payload")->Find("states"), 8);
  const double angle = std::sqrt(77.0), scale = (angle - 2 * M_PI) / angle;
  for (const int i : {3, 4, 5}) EXPECT_NEAR(state[i], (i + 1) * scale, 1e-6);
  EXPECT_EQ(state[2], 3);
  EXPECT_EQ(state[6], 7);

  const std::string least = asked(Params({}));
  EXPECT_EQ(DecodeOpenpi(std::string_view(least))->Find("payload")->Find("states"), nullptr);
}

TEST_F(VlaEvalWire, TakesAnActionUnderEitherKeyAndAsAList) {
  const ModelPeer server([](int observation, int64_t seq) {
    if (observation == 0) return ModelPeer::Action(0.5, seq, "action");
    OpenpiWriter payload;
    payload.Map(1).Text("actions").List(7);
    for (int i = 0; i < 7; ++i) payload.Real(0.5);
    return ModelPeer::Message("action", payload.Take(), seq);
  });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  for (int chunk : {0, 1}) {
    const auto predicted = (*policy)->Predict(observation_, chunk);
    ASSERT_TRUE(predicted.ok()) << predicted.status();
    EXPECT_EQ(predicted->actions, Eigen::MatrixXf::Constant(1, 7, 0.5f));
  }
}

TEST_F(VlaEvalWire, SaysWhatIsNoAnswer) {
  const absl::Status failed = Failure([](int, int64_t seq) {
    return ModelPeer::Message(
        "error",
        OpenpiWriter().Map(1).Text("error").Text("observation_failed: KeyError: 'x'").Take(), seq);
  });
  EXPECT_EQ(failed.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(std::string(failed.message()),
              HasSubstr("/: the policy server failed: observation_failed: KeyError: 'x'"));
  EXPECT_THAT(Failure([](int, int64_t seq) { return ModelPeer::Action(0, seq - 1); }).message(),
              HasSubstr("continuous_inference"));
  EXPECT_THAT(Failure([](int, int64_t seq) {
                return ModelPeer::Message("hello", OpenpiWriter().Map(0).Take(), seq);
              }).message(),
              HasSubstr("answers an observation with 'hello'"));
  EXPECT_THAT(Failure([](int, int64_t) { return OpenpiWriter().Map(0).Take(); }).message(),
              HasSubstr("without vla-eval's type, payload and seq"));
  EXPECT_THAT(Failure([](int, int64_t) { return std::string("\xc1garbage"); }).message(),
              HasSubstr("no message of vla-eval's"));
  EXPECT_THAT(Failure([](int, int64_t seq) {
                return ModelPeer::Message("action", OpenpiWriter().Map(0).Take(), seq);
              }).message(),
              HasSubstr("expected an array"));
  EXPECT_THAT(Failure([](int, int64_t seq) { return ModelPeer::Action(NAN, seq); }).message(),
              HasSubstr("nan"));
}

TEST_F(VlaEvalWire, RefusesAServerThatItCannotServe) {
  const auto refusal = [&](const std::string& params, int64_t protocol = 1) {
    const ModelPeer server([](int, int64_t seq) { return ModelPeer::Action(0, seq); }, params,
                           protocol);
    const absl::Status status = Connect(server.url()).status();
    EXPECT_THAT(std::string(status.message()), HasSubstr(server.url()));
    return std::string(status.message());
  };
  EXPECT_THAT(refusal(Params({"absolute_action"})), HasSubstr("wishes absolute_action"));
  EXPECT_THAT(refusal(Params({}), 2), HasSubstr("speaks version 2"));
  options_.cameras = {"agentview"};
  EXPECT_THAT(refusal(Params({"send_wrist_image"})),
              AllOf(HasSubstr("send_wrist_image"), HasSubstr("remote.cameras names 1")));

  // openpi's server, which greets without being asked.
  const auto peer = ScriptedPeer::WebSocket([](ScriptedPeer::Socket& web) {
    ScriptedPeer::Write(web, OpenpiWriter().Map(0).Take());
    ScriptedPeer::AwaitEnd(web);
  });
  const absl::Status openpi = Connect(peer.url()).status();
  EXPECT_EQ(openpi.code(), absl::StatusCode::kFailedPrecondition);
  EXPECT_THAT(std::string(openpi.message()), HasSubstr("choose its keys by --dialect"));
}

}  // namespace
}  // namespace robostress
