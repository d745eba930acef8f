#include "common/wire/remote_policy.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <atomic>
#include <chrono>
#include <cstdint>
#include <ctime>
#include <limits>
#include <memory>
#include <string>
#include <thread>
#include <vector>

#include "common/wire/openpi_readers.h"
#include "common/wire/openpi_writer.h"
#include "tests/common/wire/policy_peer.h"

namespace robostress {
namespace {

// What this program takes for the time of day.
class TimeOfDay {
 public:
  static void Set(int64_t ahead_s) { ahead_s_ = ahead_s; }
  static int64_t ahead_s() { return ahead_s_; }

 private:
  static inline std::atomic<int64_t> ahead_s_ = 0;
};

}  // namespace
}  // namespace robostress

// The libraries' own calls come here too.
extern "C" int clock_gettime(clockid_t clock, timespec* time) noexcept {
  const auto result = static_cast<int>(syscall(SYS_clock_gettime, clock, time));
  if (result == 0 && clock == CLOCK_REALTIME) time->tv_sec += robostress::TimeOfDay::ahead_s();
  return result;
}

namespace robostress {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

std::string Answer(const Eigen::MatrixXf& actions) {
  return OpenpiWriter().Map(1).Text("actions").Array(actions).Take();
}
std::string Zeros(int rows, int cols) { return Answer(Eigen::MatrixXf::Zero(rows, cols)); }

class RemotePolicyTest : public ::testing::Test {
 protected:
  RemotePolicyTest() {
    setting_.policy = "pi05";
    setting_.suite = "tabletop_goal";
    setting_.scenario = "clean";
    options_.dialect = *OpenpiDialectNamed("libero");
    options_.cameras = {"agentview"};
    options_.image_size = 2;
    observation_.instruction = "lift it";
    observation_.views = {{"agentview", {2, 2, std::vector<uint8_t>(12, 7)}}};
    observation_.proprioception = Eigen::VectorXf::LinSpaced(8, 0, 1);
    connection_.answer_timeout = connection_.first_answer_timeout = absl::Seconds(5);
    connection_.absence = absl::Milliseconds(300);
  }
  absl::StatusOr<std::unique_ptr<RemotePolicy>> Connect(const std::string& url,
                                                        const std::string& stream = "policy") {
    auto policy = RemotePolicy::Connect(url, options_, setting_, stream, connection_);
    if (policy.ok()) {
      EXPECT_TRUE((*policy)->StartEpisode({3, 4}).ok());
    }
    return policy;
  }
  // What a prediction fails with where the server answers so.
  absl::Status Failure(const std::string& reply) {
    const PolicyPeer server([&](int, int) { return reply; });
    auto policy = Connect(server.url());
    if (!policy.ok()) return policy.status();
    const absl::Status status = (*policy)->Predict(observation_, 0).status();
    EXPECT_EQ((*policy)->reconnections(), 0) << "asking again would change nothing";
    return status;
  }

  SessionSetting setting_;
  RemotePolicyOptions options_;
  RemotePolicyConnection connection_;
  Observation observation_;
};

TEST_F(RemotePolicyTest, PredictsWhatTheServerSaysAndLearnsTheHorizon) {
  const PolicyPeer server([](int, int message) {
    return Answer(Eigen::MatrixXf::Constant(10, 7, 0.25f * static_cast<float>(message)));
  });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  EXPECT_EQ((*policy)->spec().horizon, 10);
  const PredictedChunk predicted = *(*policy)->Predict(observation_, 1);
  EXPECT_EQ(predicted.actions, Eigen::MatrixXf::Constant(10, 7, 0.25f));
  EXPECT_EQ(predicted.prediction_id, 2u);
  EXPECT_EQ(predicted.policy_actions, predicted.actions);
}

TEST_F(RemotePolicyTest, ASeedIsAFunctionOfTheEpisodeAndOfNothingElse) {
  options_.dialect = *OpenpiDialectNamed("vllm_omni");
  std::vector<int64_t> seeds;
  const auto ask = [&](const std::string& stream) {
    const PolicyPeer server([](int, int) { return Zeros(10, 7); });
    auto policy = Connect(server.url(), stream);
    ASSERT_TRUE(policy.ok()) << policy.status();
    for (int chunk : {0, 1}) ASSERT_TRUE((*policy)->Predict(observation_, chunk).ok());
    for (size_t i : {1, 2}) seeds.push_back(server.Integer(i, "seed"));  // 0: the reset
  };
  ask("policy");
  setting_.scenario = "aged_transmission";  // paired with the one before
  setting_.severity = 2;
  ask("policy");
  ask("null");
  setting_.seed = 1;
  ask("policy");
  ASSERT_THAT(seeds, SizeIs(8));
  EXPECT_EQ(seeds[0], seeds[2]);
  EXPECT_EQ(seeds[1], seeds[3]);
  for (const int other : {1, 4, 6}) EXPECT_NE(seeds[0], seeds[other]);
  for (const int64_t seed : seeds) EXPECT_TRUE(seed >= 0 && seed <= 0x7fffffff) << seed;
}

TEST_F(RemotePolicyTest, SendsTheNoiseItself) {
  options_.dialect = *OpenpiDialectNamed("sglang");
  options_.dialect.path = "";
  options_.noise_rows = 6;
  options_.noise_cols = 3;
  const PolicyPeer server([](int, int) { return Zeros(10, 7); });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  const std::string bytes = server.told().at(0);
  const OpenpiValue told = *DecodeOpenpi(std::string_view(bytes));
  const Eigen::MatrixXd noise = *OpenpiMatrix("noise", *told.Find("noise"), 6, 3);
  EXPECT_LT(noise.cwiseAbs().maxCoeff(), 6);
  EXPECT_GT((noise.array() - noise(0, 0)).abs().maxCoeff(), 0.1);
  options_.noise_cols = 0;
  EXPECT_THAT(Connect(server.url()).status().message(), HasSubstr("remote.noise_cols is 0"));
}

TEST_F(RemotePolicyTest, AsksTheSameAgainWhereTheConnectionEnds) {
  options_.dialect = *OpenpiDialectNamed("vllm_omni");
  // The first connection ends at its second question, the second one at once.
  const PolicyPeer server([](int connection, int message) {
    return connection == 0 && message == 2 ? "" : connection == 1 ? "" : Zeros(10, 7);
  });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  for (int chunk : {0, 1, 2}) ASSERT_TRUE((*policy)->Predict(observation_, chunk).ok()) << chunk;
  EXPECT_EQ((*policy)->reconnections(), 2);
  EXPECT_FALSE((*policy)->metadata_changed());
  const auto told = server.told();  // reset, 0, 1 (lost), 1 (lost), 1, 2
  ASSERT_THAT(told, SizeIs(6));
  EXPECT_EQ(told[2], told[3]);
  EXPECT_EQ(told[2], told[4]);
  EXPECT_NE(told[4], told[5]);
}

TEST_F(RemotePolicyTest, BeginsAnEpisodeAsTheDialectSays) {
  options_.dialect = *OpenpiDialectNamed("vllm_omni");
  const PolicyPeer server([](int, int) { return Zeros(10, 7); });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  const auto told = server.told();
  ASSERT_THAT(told, SizeIs(2));
  EXPECT_THAT(told[0], AllOf(HasSubstr("endpoint"), HasSubstr("reset"), HasSubstr("session_id")));
  EXPECT_THAT(told[1], Not(HasSubstr("endpoint")));
}

TEST_F(RemotePolicyTest, EndsWhereTheServerStaysAway) {
  auto server = std::make_unique<PolicyPeer>([](int, int) { return std::string(); });
  const std::string url = server->url();
  auto policy = Connect(url);
  ASSERT_TRUE(policy.ok()) << policy.status();
  server.reset();
  const absl::Status gone = (*policy)->Predict(observation_, 0).status();
  EXPECT_EQ(gone.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(gone.message(), AllOf(HasSubstr(url), HasSubstr("run the same command again")));
  // A wrong port, at the start.
  EXPECT_EQ(Connect(url).status().code(), absl::StatusCode::kUnavailable);
}

TEST_F(RemotePolicyTest, AServerThatHangsAndStartsAnewLosesNoEpisode) {
  connection_.absence = absl::Seconds(1);  // counts from when it was missed, not from the question
  connection_.answer_timeout = absl::Milliseconds(1100);
  std::atomic<bool> killed = false;
  auto server = std::make_unique<PolicyPeer>([&](int, int message) {
    while (message == 1 && !killed) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    return killed ? std::string() : Zeros(10, 7);
  });
  auto policy = Connect(server->url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  std::thread restart([&] {
    std::this_thread::sleep_for(std::chrono::milliseconds(1300));
    const uint16_t port = server->port();
    killed = true;
    server.reset();
    std::this_thread::sleep_for(std::chrono::milliseconds(100));
    server = std::make_unique<PolicyPeer>([](int, int) { return Zeros(10, 7); }, port);
  });
  const auto predicted = (*policy)->Predict(observation_, 1);
  restart.join();
  EXPECT_TRUE(predicted.ok()) << predicted.status();
  EXPECT_EQ((*policy)->reconnections(), 1);
}

TEST_F(RemotePolicyTest, AServerThatNeverAnswersIsNotAskedForever) {
  connection_.first_answer_timeout = absl::Milliseconds(200);
  std::atomic<int> asked = 0;
  std::atomic<bool> over = false;
  const PolicyPeer mute([&](int, int) {
    ++asked;
    while (!over) std::this_thread::sleep_for(std::chrono::milliseconds(10));
    return std::string();
  });
  auto policy = Connect(mute.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  const absl::Status silent = (*policy)->Predict(observation_, 0).status();
  over = true;
  EXPECT_EQ(silent.code(), absl::StatusCode::kUnavailable);
  EXPECT_THAT(silent.message(), HasSubstr("does not answer within 200ms"));
  EXPECT_EQ(asked, 1);
}

TEST_F(RemotePolicyTest, AfterAConnectionTheServerMayCompileAgain) {
  connection_.answer_timeout = absl::Milliseconds(150);
  const PolicyPeer server([](int connection, int message) -> std::string {
    if (connection == 0 && message == 1) return "";  // it starts anew
    if (connection == 1 && message == 0)
      std::this_thread::sleep_for(std::chrono::milliseconds(400));
    return Zeros(10, 7);
  });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  EXPECT_TRUE((*policy)->Predict(observation_, 1).ok());
  EXPECT_EQ((*policy)->reconnections(), 1);
}

TEST_F(RemotePolicyTest, AResetIsAnsweredButPredictsNothing) {
  options_.dialect = *OpenpiDialectNamed("vllm_omni");
  connection_.answer_timeout = absl::Milliseconds(150);
  const PolicyPeer slow([](int, int message) {
    if (message == 1) std::this_thread::sleep_for(std::chrono::milliseconds(400));  // it compiles
    return Zeros(10, 7);
  });
  auto policy = Connect(slow.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  EXPECT_TRUE((*policy)->Predict(observation_, 0).ok());
  EXPECT_EQ((*policy)->reconnections(), 0);

  const PolicyPeer refusing([](int, int) {
    return OpenpiWriter().Map(2).Text("type").Text("error").Text("message").Text("full").Take();
  });
  policy = RemotePolicy::Connect(refusing.url(), options_, setting_, "policy", connection_);
  ASSERT_TRUE(policy.ok()) << policy.status();
  EXPECT_THAT((*policy)->StartEpisode({0, 0}).message(),
              AllOf(HasSubstr("refuses: full"), HasSubstr("vllm_omni")));
}

TEST_F(RemotePolicyTest, AServerThatTakesNoSeedIsNotPaired) {
  options_.dialect = *OpenpiDialectNamed("lerobot");
  for (const bool takes : {false, true}) {
    OpenpiWriter metadata;
    metadata.Map(1).Text("extensions").List(takes ? 2 : 1).Text("reset");
    if (takes) metadata.Text("seed");
    const PolicyPeer server([](int, int) { return Zeros(10, 7); }, metadata.Take());
    auto policy = Connect(server.url());
    ASSERT_TRUE(policy.ok()) << policy.status();
    EXPECT_EQ((*policy)->pairs_noise(), takes);
    ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
    EXPECT_EQ(server.told().at(0).find("seed") != std::string::npos, takes);
  }
}

TEST_F(RemotePolicyTest, ALateAnswerIsNotTakenForTheNextQuestions) {
  const PolicyPeer server([](int connection, int message) {
    if (connection == 0 && message == 1)
      std::this_thread::sleep_for(std::chrono::milliseconds(400));
    return Answer(Eigen::MatrixXf::Constant(10, 7, static_cast<float>(connection)));
  });
  connection_.answer_timeout = absl::Milliseconds(150);
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  const auto late = (*policy)->Predict(observation_, 1);
  ASSERT_TRUE(late.ok()) << late.status();
  EXPECT_EQ(late->actions(0, 0), 1) << "of the second connection";
}

TEST_F(RemotePolicyTest, RefusesAnswersThatCannotBeUsed) {
  EXPECT_THAT(Failure(Zeros(10, 32)).message(), HasSubstr("[10, 32]"));
  EXPECT_THAT(Failure(Zeros(4, 7)).message(), HasSubstr("[4, 7]"));
  Eigen::MatrixXf nan = Eigen::MatrixXf::Zero(10, 7);
  nan(3, 2) = std::numeric_limits<float>::quiet_NaN();
  EXPECT_THAT(Failure(Answer(nan)).message(), HasSubstr("nan"));
  EXPECT_EQ(Failure("\xc1garbage").code(), absl::StatusCode::kInvalidArgument);
  const absl::Status text = Failure("Traceback\nKeyError: 'observation/wrist_image'");
  EXPECT_EQ(text.code(), absl::StatusCode::kInternal);
  EXPECT_THAT(text.message(), HasSubstr("KeyError: 'observation/wrist_image'"));
  const absl::Status map =
      Failure(OpenpiWriter().Map(2).Text("type").Text("error").Text("message").Text("no").Take());
  EXPECT_THAT(map.message(), HasSubstr("refuses: no"));
}

TEST_F(RemotePolicyTest, AChunkThatChangesItsLengthIsRefused) {
  const PolicyPeer server([](int, int message) { return Zeros(10 + message, 7); });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  EXPECT_THAT((*policy)->Predict(observation_, 1).status().message(), HasSubstr("[11, 7]"));
}

TEST_F(RemotePolicyTest, SeesThatMetadataChangedOrContradict) {
  const PolicyPeer server(
      [](int connection, int) { return connection <= 1 ? "" : Zeros(10, 7); },
      [](int connection) {
        return OpenpiWriter().Map(1).Text("model").Integer(connection / 2).Take();
      });
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  EXPECT_EQ((*policy)->metadata(), R"({"model":0})");
  ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
  EXPECT_TRUE((*policy)->metadata_changed());

  // What differs between two connections in a row says nothing of the model.
  const auto counting = [](int64_t model) {
    return [model](int connection) {
      return OpenpiWriter()
          .Map(2)
          .Text("model")
          .Integer(model)
          .Text("uptime_s")
          .Integer(connection)
          .Take();
    };
  };
  std::vector<std::string> hashes;
  for (const int64_t model : {1, 1, 2}) {
    const PolicyPeer peer([](int connection, int) { return connection == 1 ? "" : Zeros(10, 7); },
                          counting(model));
    auto counted = Connect(peer.url());
    ASSERT_TRUE(counted.ok()) << counted.status();
    ASSERT_TRUE((*counted)->Predict(observation_, 0).ok());
    EXPECT_EQ((*counted)->reconnections(), 1);
    EXPECT_FALSE((*counted)->metadata_changed());
    hashes.push_back((*counted)->spec().model_hash);
  }
  EXPECT_EQ(hashes[0], hashes[1]);
  EXPECT_NE(hashes[0], hashes[2]);

  const PolicyPeer wide(
      [](int, int) { return Zeros(10, 7); },
      OpenpiWriter().Map(1).Text("output").Map(1).Text("action_dim").Integer(32).Take());
  EXPECT_THAT(Connect(wide.url()).status().message(),
              AllOf(HasSubstr("action_dim 32"), HasSubstr("remote.action_dim is 7")));
  const PolicyPeer few(
      [](int, int) { return Zeros(10, 7); },
      OpenpiWriter().Map(1).Text("output").Map(1).Text("action_horizon").Integer(4).Take());
  EXPECT_THAT(Connect(few.url()).status().message(),
              AllOf(HasSubstr("action_horizon 4"), HasSubstr("remote.execute_steps is 5")));
}

// A server of ours that starts again with another policy.
TEST_F(RemotePolicyTest, AModelThatWishesForSomethingElseInMidRunIsRefused) {
  options_.dialect = *OpenpiDialectNamed("robostress");
  const auto wishes = [](int64_t steps, int64_t width, const char* camera) {
    OpenpiWriter metadata;
    metadata.Map(1).Text("policies").List(1).Map(4).Text("name").Text("pi05");
    metadata.Text("execute_steps").Integer(steps).Text("image_width").Integer(width);
    return metadata.Text("cameras").List(1).Text(camera).Take();
  };
  for (const std::string& later : {wishes(20, 2, "agentview"), wishes(5, 3, "agentview"),
                                   wishes(5, 2, "wrist"), wishes(5, 2, "agentview")}) {
    const PolicyPeer server(
        [](int connection, int message) {
          return connection == 1 && message == 1 ? std::string() : Zeros(10, 7);
        },
        [&](int connection) { return connection < 2 ? wishes(5, 2, "agentview") : later; });
    auto policy = Connect(server.url());
    ASSERT_TRUE(policy.ok()) << policy.status();
    ASSERT_TRUE((*policy)->Predict(observation_, 0).ok());
    const auto after = (*policy)->Predict(observation_, 1);
    EXPECT_EQ((*policy)->spec().execute_steps, 5);
    if (later == wishes(5, 2, "agentview")) {
      EXPECT_TRUE(after.ok()) << after.status();
      continue;
    }
    EXPECT_EQ(after.status().code(), absl::StatusCode::kFailedPrecondition);
    EXPECT_THAT(after.status().message(),
                AllOf(HasSubstr(server.url()), HasSubstr("another model now"),
                      HasSubstr("[agentview] of 2 x 2 px, execute_steps 5 when the unit began")));
  }
}

TEST_F(RemotePolicyTest, KeepsLongWordsOfMetadataAsTheirHash) {
  const PolicyPeer server([](int, int) { return Zeros(10, 7); },
                          OpenpiWriter().Map(1).Text("log").Text(std::string(5000, 'x')).Take());
  auto policy = Connect(server.url());
  ASSERT_TRUE(policy.ok()) << policy.status();
  EXPECT_THAT((*policy)->metadata(), HasSubstr(R"({"log":{"bytes":5000,"sha256":")"));
  EXPECT_LT((*policy)->metadata().size(), 200u);
}

// The time of day is set while a server is away: an hour ahead, an hour back.
TEST_F(RemotePolicyTest, ASetClockIsNoAbsence) {
  connection_.absence = absl::Seconds(3);
  for (const int64_t set_s : {3600, -3600}) {
    auto server = std::make_unique<PolicyPeer>([](int, int) { return std::string(); });
    const uint16_t port = server->port();
    auto policy = Connect(server->url());
    ASSERT_TRUE(policy.ok()) << policy.status();
    server.reset();
    std::thread returns([&] {
      std::this_thread::sleep_for(std::chrono::milliseconds(300));
      TimeOfDay::Set(set_s);
      std::this_thread::sleep_for(std::chrono::milliseconds(set_s > 0 ? 700 : 4000));
      server = std::make_unique<PolicyPeer>([](int, int) { return Zeros(10, 7); }, port);
    });
    const auto predicted = (*policy)->Predict(observation_, 0);
    returns.join();
    TimeOfDay::Set(0);
    EXPECT_EQ(predicted.ok(), set_s > 0) << set_s << " " << predicted.status();
  }
}

}  // namespace
}  // namespace robostress
