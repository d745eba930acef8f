// Valid greetings and answers of every dialect's servers with one to three values changed: what
// RemotePolicy makes of them.
//
//   ROBOSTRESS_POLICY_CASES=100000 build/release/test_bin/policy_fuzz_test     # 2,000 without it
//
// ROBOSTRESS_POLICY_FIRST starts at another case; a case is a function of its number alone. Every
// case ends in time. It is a refusal that names the server's address, or chunks that are finite, of
// the shape that was announced, and number by number what stands in the answer, read here by other
// code.
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <vector>

#include "absl/strings/match.h"
#include "absl/strings/numbers.h"
#include "absl/strings/str_cat.h"
#include "common/rollout/message_limits.h"
#include "common/wire/openpi_dialect.h"
#include "common/wire/remote_policy.h"
#include "nlohmann/json.hpp"
#include "spdlog/spdlog.h"
#include "tests/common/wire/scripted_peer.h"
#include "tests/common/wire/wild_value.h"

namespace robostress {
namespace {

constexpr int kRows = 10, kCols = 7, kExecute = 5, kState = 8;

// What one server says in one case.
struct Script {
  bool vla_eval = false;
  std::vector<Wild> greetings;  // of each connection; the last of all others
  std::vector<Wild> answers;    // to each observation, likewise
  int closes_after = -1;        // answers; -1: never
};

// A server that says it, one connection after another. Of vla-eval's it copies `seq` where the
// answer holds -7.
class WildPeer {
 public:
  using Error = ScriptedPeer::Error;

  WildPeer() : thread_([this] { Accept(); }) {}
  ~WildPeer() {
    ended_ = true;
    Error ignored;
    ScriptedPeer::Tcp::socket(io_).connect(acceptor_.local_endpoint(), ignored);
    thread_.join();
  }
  std::string address() const {
    return absl::StrCat("127.0.0.1:", acceptor_.local_endpoint().port());
  }
  // From the next connection on.
  void Say(Script script) {
    const std::lock_guard lock(mutex_);
    script_ = std::move(script);
    connections_ = answered_ = 0;
  }

 private:
  void Accept() {
    while (true) {
      Error error;
      ScriptedPeer::Tcp::socket socket(io_);
      acceptor_.accept(socket, error);
      if (error || ended_) return;
      socket.set_option(ScriptedPeer::Tcp::no_delay(true), error);
      ScriptedPeer::Socket web(std::move(socket));
      web.accept(error);
      web.binary(true);
      if (!error) Talk(web);
    }
  }
  void Talk(ScriptedPeer::Socket& web) {
    Script script;
    size_t connection = 0;
    {
      const std::lock_guard lock(mutex_);
      script = script_;
      connection = connections_++;
    }
    const auto nth = [](const std::vector<Wild>& values, size_t n) {
      return values[std::min(n, values.size() - 1)];
    };
    if (script.vla_eval && ScriptedPeer::Read(web).empty()) return;  // hello
    ScriptedPeer::Write(web, nth(script.greetings, connection).Bytes());
    while (true) {
      const std::string told = ScriptedPeer::Read(web);
      if (told.empty()) return;
      if (script.vla_eval && !absl::StrContains(told, "observation")) continue;
      const size_t n = answered_++;
      if (script.closes_after == static_cast<int>(n)) return;
      Wild answer = nth(script.answers, n);
      Echo(told, answer);
      ScriptedPeer::Write(web, answer.Bytes());
    }
  }
  // The question's seq, which is below 128 and so one byte.
  static void Echo(const std::string& told, Wild& answer) {
    auto* map = std::get_if<Wild::Map>(&answer.value);
    const size_t at = told.rfind("seq");
    if (map == nullptr || at == std::string::npos || at + 3 >= told.size()) return;
    for (auto& [key, item] : *map) {
      const auto* whole = std::get_if<int64_t>(&item.value);
      if (whole != nullptr && *whole == -7) item = Wild::Whole(told[at + 3]);
    }
  }

  boost::asio::io_context io_;
  ScriptedPeer::Tcp::acceptor acceptor_{
      io_, ScriptedPeer::Tcp::endpoint(boost::asio::ip::make_address("127.0.0.1"), 0)};
  std::atomic<bool> ended_ = false;
  std::mutex mutex_;
  Script script_;
  size_t connections_ = 0;
  std::atomic<size_t> answered_ = 0;
  std::thread thread_;
};

// ------------------------------------------------------------------------------ what servers say

std::vector<float> SomeNumbers(RandomStream& random, int count) {
  std::vector<float> numbers;
  for (int i = 0; i < count; ++i) numbers.push_back(static_cast<float>(random.Normal()));
  return numbers;
}

Wild GreetingOf(const std::string& dialect) {
  const auto texts = [](const std::vector<std::string>& words) {
    Wild::List list;
    for (const std::string& word : words) list.push_back(Wild::Text(word));
    return Wild::Of(std::move(list));
  };
  if (dialect == "libero")
    return Wild::Pairs(
        {{"reset_pose", Wild::Numbers<float>("<f4", {2}, {0, 1})}, {"model", Wild::Text("pi05")}});
  if (dialect == "sglang")
    return Wild::Pairs({{"output", Wild::Pairs({{"action_dim", Wild::Whole(kCols)},
                                                {"action_horizon", Wild::Whole(kRows)}})},
                        {"input", Wild::Pairs({{"state_dim", Wild::Whole(kState)}})}});
  if (dialect == "lerobot") return Wild::Pairs({{"extensions", texts({"seed", "reset"})}});
  if (dialect == "robostress")
    return Wild::Pairs(
        {{"policies", Wild::Of(Wild::List{Wild::Pairs({{"name", Wild::Text("pi05")},
                                                       {"image_width", Wild::Whole(2)},
                                                       {"image_height", Wild::Whole(2)},
                                                       {"execute_steps", Wild::Whole(kExecute)},
                                                       {"state_dim", Wild::Whole(kState)},
                                                       {"action_dim", Wild::Whole(kCols)},
                                                       {"cameras", texts({"agentview"})}})})}});
  if (dialect == "vla_eval")
    return Wild::Pairs(
        {{"type", Wild::Text("hello")},
         {"payload", Wild::Pairs({{"protocol_version", Wild::Whole(1)},
                                  {"model_server", Wild::Text("Tiny")},
                                  {"observation_params",
                                   Wild::Pairs({{"send_state", Wild::Of(true)},
                                                {"send_wrist_image", Wild::Of(false)},
                                                {"absolute_action", Wild::Of(false)}})}})},
         {"seq", Wild::Whole(1)},
         {"timestamp", Wild::Of(1.5)}});
  return Wild::Pairs({});  // vllm_omni
}

Wild AnswerOf(const std::string& dialect, RandomStream& random) {
  if (dialect == "vla_eval") {
    const std::vector<float> row = SomeNumbers(random, kCols);
    Wild actions = Wild::Numbers("<f4", {kCols}, row);
    if (random.UniformInt(2) == 0) {
      Wild::List list;
      for (const float number : row) list.push_back(Wild::Of(static_cast<double>(number)));
      actions = Wild::Of(std::move(list));
    }
    return Wild::Pairs({{"type", Wild::Text("action")},
                        {"payload", Wild::Pairs({{"actions", std::move(actions)}})},
                        {"seq", Wild::Whole(-7)},
                        {"timestamp", Wild::Of(2.5)}});
  }
  const std::vector<float> numbers = SomeNumbers(random, kRows * kCols);
  if (dialect == "vllm_omni") return Wild::Numbers("<f4", {1, kRows, kCols}, numbers);
  Wild actions = Wild::Numbers("<f4", {kRows, kCols}, numbers);
  if (random.UniformInt(2) == 0)
    actions =
        Wild::Numbers("<f8", {kRows, kCols}, std::vector<double>(numbers.begin(), numbers.end()));
  return Wild::Pairs({{"actions", std::move(actions)},
                      {"state", Wild::Numbers<float>("<f4", {2}, {0, 1})},
                      {"policy_timing", Wild::Pairs({{"infer_ms", Wild::Of(12.5)}})},
                      {"server_timing", Wild::Pairs({{"infer_ms", Wild::Whole(13)}})}});
}

// ------------------------------------------------------------- what stands in an answer, read here

std::optional<std::string> TextOf(const Wild* at) {
  if (at == nullptr) return std::nullopt;
  if (const auto* text = std::get_if<std::string>(&at->value)) return *text;
  if (const auto* bin = std::get_if<Wild::Bin>(&at->value)) return bin->bytes;
  return std::nullopt;
}

std::optional<Wild::Array> ArrayOf(const Wild& at) {
  if (const auto* array = std::get_if<Wild::Array>(&at.value)) return *array;
  const auto dtype = TextOf(at.Find("dtype")), data = TextOf(at.Find("data"));
  const Wild *shape = at.Find("shape"), *mark = at.Find("__ndarray__");
  const bool* marked = mark == nullptr ? nullptr : std::get_if<bool>(&mark->value);
  const auto* sizes = shape == nullptr ? nullptr : std::get_if<Wild::List>(&shape->value);
  if (marked == nullptr || !*marked || !dtype || !data || sizes == nullptr) return std::nullopt;
  Wild::Array array{*dtype, {}, *data};
  for (const Wild& size : *sizes) {
    const auto* whole = std::get_if<int64_t>(&size.value);
    if (whole == nullptr) return std::nullopt;
    array.shape.push_back(*whole);
  }
  return array;
}

double NumberOf(const Wild& at) {
  if (const auto* whole = std::get_if<int64_t>(&at.value)) return static_cast<double>(*whole);
  if (const auto* whole = std::get_if<uint64_t>(&at.value)) return static_cast<double>(*whole);
  if (const auto* flag = std::get_if<bool>(&at.value)) return *flag ? 1 : 0;
  if (const auto* real = std::get_if<float>(&at.value)) return static_cast<double>(*real);
  if (const auto* real = std::get_if<double>(&at.value)) return *real;
  return std::nan("");
}

template <class T>
std::vector<double> Unpacked(const std::string& data) {
  std::vector<double> numbers;
  for (size_t at = 0; at + sizeof(T) <= data.size(); at += sizeof(T)) {
    T value;
    std::memcpy(&value, data.data() + at, sizeof(T));
    numbers.push_back(static_cast<double>(value));
  }
  return numbers;
}

std::vector<double> NumbersOf(const Wild& at) {
  std::vector<double> numbers;
  if (const auto* list = std::get_if<Wild::List>(&at.value)) {
    for (const Wild& item : *list) numbers.push_back(NumberOf(item));
    return numbers;
  }
  const auto array = ArrayOf(at);
  if (!array || array->dtype.size() != 3) return {};
  const std::string kind = array->dtype.substr(1);
  if (kind == "f4") return Unpacked<float>(array->data);
  if (kind == "f8") return Unpacked<double>(array->data);
  if (kind == "i4") return Unpacked<int32_t>(array->data);
  if (kind == "i8") return Unpacked<int64_t>(array->data);
  if (kind == "u1" || kind == "b1") return Unpacked<uint8_t>(array->data);
  return {};
}

// Where the actions are, by the rule of openpi_answer.h.
const Wild* ActionsOf(const Wild& answer, bool vla_eval) {
  const Wild* at = vla_eval ? answer.Find("payload") : &answer;
  if (at == nullptr || ArrayOf(*at)) return at;
  for (const char* key : {"actions", "action"})
    if (const Wild* found = at->Find(key)) return found;
  const auto* map = std::get_if<Wild::Map>(&at->value);
  return map != nullptr && map->size() == 1 ? &map->front().second : nullptr;
}

// ------------------------------------------------------------------------------------- one case

uint64_t FromEnvironment(const char* variable, uint64_t otherwise) {
  const char* text = std::getenv(variable);
  uint64_t number = otherwise;
  EXPECT_TRUE(text == nullptr || absl::SimpleAtoi(text, &number)) << variable << "=" << text;
  return number;
}

class PolicyFuzz : public ::testing::Test {
 protected:
  PolicyFuzz() {
    setting_.policy = "pi05";
    setting_.suite = "tabletop_goal";
    setting_.scenario = "clean";
    observation_.instruction = "lift it";
    observation_.views = {{"agentview", {2, 2, std::vector<uint8_t>(12, 7)}}};
    observation_.proprioception = Eigen::VectorXf::LinSpaced(kState, 0, 1);
    connection_.answer_timeout = connection_.first_answer_timeout = absl::Seconds(5);
    connection_.wire.metadata_timeout = absl::Seconds(5);
    connection_.absence = absl::Milliseconds(10);
  }

  RemotePolicyOptions OptionsFor(const std::string& dialect) const {
    RemotePolicyOptions options;
    options.dialect = *OpenpiDialectNamed(dialect);
    options.dialect.path = "";
    options.cameras = {"agentview"};
    options.image_size = 2;
    options.state_dim = kState;
    options.action_dim = kCols;
    options.execute_steps = dialect == "vla_eval" ? 1 : kExecute;
    options.noise_rows = options.noise_cols = 3;
    return options;
  }
  void Refused(const absl::Status& status) {
    ++refused_;
    EXPECT_TRUE(absl::StrContains(status.message(), peer_.address())) << status;
    EXPECT_LT(status.message().size(), 8000u);
  }
  void Accepted(const RemotePolicy& policy, const PredictedChunk& chunk, const Wild& answer,
                bool vla_eval) {
    ++accepted_;
    const PolicySpec& spec = policy.spec();
    ASSERT_EQ(chunk.actions.rows(), spec.horizon);
    ASSERT_GE(chunk.actions.rows(), spec.execute_steps);
    ASSERT_LE(chunk.actions.rows(), WireLimits::kHorizon);
    ASSERT_EQ(chunk.actions.cols(), kCols);
    ASSERT_TRUE(chunk.actions.allFinite());
    ASSERT_TRUE(std::isfinite(chunk.compute_ms) && chunk.compute_ms >= 0);
    const Wild* actions = ActionsOf(answer, vla_eval);
    ASSERT_NE(actions, nullptr) << "actions out of nothing";
    const std::vector<double> said = NumbersOf(*actions);
    ASSERT_EQ(said.size(), static_cast<size_t>(chunk.actions.size()));
    for (Eigen::Index i = 0; i < chunk.actions.size(); ++i) {
      ASSERT_EQ(chunk.actions(i / kCols, i % kCols),
                static_cast<float>(said[static_cast<size_t>(i)]));
    }
    EXPECT_EQ(chunk.policy_actions, chunk.actions);
    EXPECT_TRUE(nlohmann::json::accept(policy.metadata()));
  }
  void Case(const std::string& dialect, const Script& script) {
    peer_.Say(script);
    auto policy = RemotePolicy::Connect("ws://" + peer_.address(), OptionsFor(dialect), setting_,
                                        "policy", connection_);
    if (!policy.ok()) return Refused(policy.status());
    const PolicySpec agreed = (*policy)->spec();
    size_t asked = 0;
    if (const absl::Status begun = (*policy)->StartEpisode({3, 4}); !begun.ok())
      return Refused(begun);
    if (dialect == "vllm_omni")  // its reset is answered
      asked = 1 + static_cast<size_t>((*policy)->reconnections());
    for (int chunk = 0; chunk < 3; ++chunk) {
      const int before = (*policy)->reconnections();
      const auto predicted = (*policy)->Predict(observation_, chunk);
      if (!predicted.ok()) return Refused(predicted.status());
      asked += static_cast<size_t>((*policy)->reconnections() - before);
      Accepted(**policy, *predicted, script.answers[std::min(asked++, script.answers.size() - 1)],
               script.vla_eval);
      EXPECT_EQ((*policy)->spec().cameras, agreed.cameras);
      EXPECT_EQ((*policy)->spec().execute_steps, agreed.execute_steps);
      if (HasFatalFailure()) return;
    }
  }

  WildPeer peer_;
  SessionSetting setting_;
  Observation observation_;
  RemotePolicyConnection connection_;
  int refused_ = 0, accepted_ = 0;
};

TEST_F(PolicyFuzz, ACaseIsRefusedByNameOrAccepted) {
  spdlog::set_level(spdlog::level::off);
  const std::vector<std::string> dialects = {"libero",  "vllm_omni",  "sglang",
                                             "lerobot", "robostress", "vla_eval"};
  const uint64_t first = FromEnvironment("ROBOSTRESS_POLICY_FIRST", 0),
                 cases = FromEnvironment("ROBOSTRESS_POLICY_CASES", 2000);
  for (uint64_t i = first; i < first + cases; ++i) {
    SCOPED_TRACE(absl::StrCat("case ", i));
    RandomStream random(StreamKey("policy_fuzz").With(i));
    WildMutator mutator(random);
    const std::string& dialect = dialects[i % dialects.size()];
    Script script;
    script.vla_eval = dialect == "vla_eval";
    if (random.UniformInt(3) == 0) script.closes_after = random.UniformInt(4);
    for (int k = 0; k < 4; ++k) script.greetings.push_back(GreetingOf(dialect));
    for (int k = 0; k < 5; ++k) script.answers.push_back(AnswerOf(dialect, random));
    const int what =
        random.UniformInt(4);  // greeting, that of a later connection, answers, nothing
    for (int times = random.UniformInt(3); times >= 0; --times) {
      if (what == 0) mutator.Change(script.greetings[0]);
      if (what == 1) mutator.Change(script.greetings[static_cast<size_t>(random.UniformInt(4))]);
      if (what == 2) mutator.Change(script.answers[static_cast<size_t>(random.UniformInt(4))]);
    }
    if (what == 0)
      for (Wild& greeting : script.greetings) greeting = script.greetings[0];
    const auto begin = std::chrono::steady_clock::now();
    const int refused = refused_;
    Case(dialect, script);
    EXPECT_LT(std::chrono::steady_clock::now() - begin, std::chrono::seconds(20));
    EXPECT_TRUE(what != 3 || refused_ == refused) << "nothing was wrong";
    if (HasFailure()) return;
  }
  std::cout << accepted_ << " chunks accepted, " << refused_ << " cases refused\n";
  EXPECT_GT(refused_, static_cast<int>(cases / 10));
  EXPECT_GT(accepted_, static_cast<int>(cases / 2));
}

}  // namespace
}  // namespace robostress
